// Sessions on a plan: a dot, where it goes, and how sure it is.

import { colour, onTheme } from "../theming.js";
import { h } from "../ui.js";

const CHI_95 = Math.sqrt(5.991);
const DOT_PX = 4.5;
const COLOURS = { ok: "accent", ambiguous: "warn", insufficient: "soft", off_map: "bad", disturbed: "fourth" };

/** What a status means, for those who have not read about it. */
export const STATUS_WORDS = {
  ok: "position known", ambiguous: "several places fit", insufficient: "not yet known", off_map: "off the map", disturbed: "disturbed",
};

/** Name of the colour in which a status is drawn and told. */
export function statusColour(status) {
  return COLOURS[status] ?? "soft";
}

/** Half axes (m) and angle (rad, counter-clockwise from +x) of the 95 % ellipse. */
export function ellipse95({ cov_xx: xx, cov_xy: xy, cov_yy: yy }) {
  const mean = (xx + yy) / 2;
  const root = Math.hypot((xx - yy) / 2, xy);
  return {
    major: CHI_95 * Math.sqrt(Math.max(0, mean + root)),
    minor: CHI_95 * Math.sqrt(Math.max(0, mean - root)),
    angle: 0.5 * Math.atan2(2 * xy, xx - yy),
  };
}

/**
 * Sessions over a PlanView, on a canvas of their own: they move several times a second, and the plan below need not be
 * drawn again for that.
 */
export class SessionsOverlay {
  constructor(view) {
    this.view = view;
    this.sessions = [];
    this.canvas = h("canvas", { class: "overlay", "aria-hidden": "true" });
    view.element.append(this.canvas);
    view.onmove = () => this.redraw();
    this.#untheme = onTheme(() => this.redraw());
  }

  #untheme;
  #pending = 0;

  /** Draw soon, once however often it is asked for. */
  redraw() {
    this.#pending ||= requestAnimationFrame(() => {
      this.#pending = 0;
      this.#draw();
    });
  }

  destroy() {
    cancelAnimationFrame(this.#pending);
    this.#untheme();
  }

  #draw() {
    const { width, height } = this.view.canvas;
    const context = this.canvas.getContext("2d");
    if (this.canvas.width !== width || this.canvas.height !== height) Object.assign(this.canvas, { width, height });
    const ratio = width / this.view.size.width || 1;
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, this.view.size.width, this.view.size.height);
    // all of a colour in one path each: a path a session costs ten times as much
    for (const [name, members] of byColour(this.sessions)) {
      const style = colour(name);
      context.fillStyle = style;
      context.strokeStyle = style;
      drawEllipses(context, this.view, members);
      drawDots(context, this.view, members);
    }
  }
}

function byColour(sessions) {
  const groups = new Map();
  for (const one of sessions) {
    if (one.x === null) continue;
    const name = statusColour(one.status);
    if (!groups.has(name)) groups.set(name, []);
    groups.get(name).push(one);
  }
  return groups;
}

function drawEllipses(context, view, members) {
  context.beginPath();
  for (const one of members) {
    const [x, y] = view.pixel(one.x, one.y);
    const { major, minor, angle } = ellipse95(one);
    context.moveTo(x + major * view.scale * Math.cos(-angle), y + major * view.scale * Math.sin(-angle));
    context.ellipse(x, y, major * view.scale, minor * view.scale, -angle, 0, 2 * Math.PI);
  }
  context.globalAlpha = 0.1;
  context.fill();
  context.globalAlpha = 0.45;
  context.lineWidth = 1;
  context.stroke();
  context.globalAlpha = 1;
}

function drawDots(context, view, members) {
  context.beginPath();
  for (const one of members) {
    const [x, y] = view.pixel(one.x, one.y);
    const turn = -(one.heading_deg * Math.PI) / 180;
    context.moveTo(x + DOT_PX, y);
    context.arc(x, y, DOT_PX, 0, 2 * Math.PI);
    if (!one.sure) continue;
    context.moveTo(x + 2.3 * DOT_PX * Math.cos(turn), y + 2.3 * DOT_PX * Math.sin(turn));
    context.lineTo(x + DOT_PX * Math.cos(turn + 1.9), y + DOT_PX * Math.sin(turn + 1.9));
    context.lineTo(x + DOT_PX * Math.cos(turn - 1.9), y + DOT_PX * Math.sin(turn - 1.9));
  }
  context.fill();
}
