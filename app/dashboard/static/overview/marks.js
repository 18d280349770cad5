// Sessions on a plan: a dot, where it goes, and how sure it is.

import { colour } from "../theming.js";

const CHI_95 = Math.sqrt(5.991);
const DOT_PX = 4.5;
const COLOURS = { ok: "accent", ambiguous: "warn", insufficient: "soft", off_map: "bad", disturbed: "fourth" };

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

/** A layer of a PlanView; set `sessions` and redraw the view. */
export function sessionsLayer() {
  return {
    visible: true,
    sessions: [],
    draw(context, view) {
      // all of a colour in one path each: a path a session costs ten times as much
      for (const [name, members] of byColour(this.sessions)) {
        const style = colour(name);
        context.fillStyle = style;
        context.strokeStyle = style;
        drawEllipses(context, view, members);
        drawDots(context, view, members);
      }
    },
  };
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
