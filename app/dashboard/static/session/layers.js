// What is drawn of a session on a plan: its track, where it is, what else it may be, what is known about it.

import { haloText } from "../canvas.js";
import { ellipse95, statusColour } from "../overview/marks.js";
import { colour } from "../theming.js";

const DOT_PX = 5.5;
const SPARSE_M = 4;
const CROSS_PX = 6;

function nameOf(word) { return word === "sure" || word === "ok" ? "accent" : statusColour(word); }

function ellipse(context, view, one) {
  const [x, y] = view.pixel(one.x, one.y);
  const { major, minor, angle } = ellipse95(one);
  context.beginPath();
  context.ellipse(x, y, major * view.scale, minor * view.scale, -angle, 0, 2 * Math.PI);
}

/** The track up to now: solid where it is sure, dashed where it claims a position only, dots where it claims none. */
export function trackLayer(log) {
  return {
    visible: true, levelId: null, now: -1, ellipses: true,
    draw(context, view) {
      const { x, y } = log.columns;
      context.lineJoin = "round";
      for (const [from, to, name] of log.stretches(this.levelId, this.now)) {
        const style = colour(nameOf(name));
        if (name !== "sure" && name !== "ok") { drawDots(context, view, log.columns, from, to, style); continue; }
        context.beginPath();
        for (let i = from; i <= to; i += 1) context.lineTo(...view.pixel(x[i], y[i]));
        for (const [ground, width] of [["plan-ground", 6.5], [null, 3]]) {
          context.setLineDash(ground || name === "sure" ? [] : [5, 4]);
          context.strokeStyle = ground ? colour(ground) : style;
          context.lineWidth = width;
          context.stroke();
        }
      }
      context.setLineDash([]);
      if (this.ellipses) this.drawEllipses(context, view);
    },
    // one every few metres: all of them would be a carpet
    drawEllipses(context, view) {
      const { level_id, status, x, y } = log.columns;
      context.lineWidth = 1;
      let last = null;
      for (let i = 0; i <= this.now; i += 1) {
        if (level_id[i] !== this.levelId || status[i] !== "ok") continue;
        if (last && Math.hypot(x[i] - last[0], y[i] - last[1]) < SPARSE_M) continue;
        last = [x[i], y[i]];
        ellipse(context, view, log.fix(i));
        context.globalAlpha = 0.5;
        context.strokeStyle = colour("accent");
        context.stroke();
        context.globalAlpha = 1;
      }
    },
  };
}

function drawDots(context, view, { x, y }, from, to, style) {
  context.fillStyle = style;
  context.globalAlpha = 0.7;
  context.beginPath();
  for (let i = from; i <= to; i += 1) {
    const [px, py] = view.pixel(x[i], y[i]);
    context.moveTo(px + 2, py);
    context.arc(px, py, 2, 0, 2 * Math.PI);
  }
  context.fill();
  context.globalAlpha = 1;
}

/** Where the session is now: its fix with the ellipse and the heading, or its hypotheses with their weights. */
export function nowLayer() {
  return {
    visible: true, levelId: null, fix: null, hypotheses: [],
    draw(context, view) {
      const others = this.hypotheses.filter((one) => one.level_id === this.levelId);
      for (const one of others) drawHypothesis(context, view, one);
      if (this.fix && this.fix.level_id === this.levelId && !others.length) drawFix(context, view, this.fix);
    },
  };
}

function drawFix(context, view, fix) {
  const style = colour(statusColour(fix.status));
  context.fillStyle = context.strokeStyle = style;
  ellipse(context, view, fix);
  context.globalAlpha = 0.16;
  context.fill();
  context.globalAlpha = 1;
  context.lineWidth = 1.6;
  context.stroke();
  const [x, y] = view.pixel(fix.x, fix.y);
  const turn = -(fix.heading_deg * Math.PI) / 180;
  context.beginPath();
  context.arc(x, y, DOT_PX, 0, 2 * Math.PI);
  context.moveTo(x + 2.8 * DOT_PX * Math.cos(turn), y + 2.8 * DOT_PX * Math.sin(turn));
  context.lineTo(x + DOT_PX * Math.cos(turn + 1.6), y + DOT_PX * Math.sin(turn + 1.6));
  context.lineTo(x + DOT_PX * Math.cos(turn - 1.6), y + DOT_PX * Math.sin(turn - 1.6));
  context.fill();
  context.lineWidth = 1.5;
  context.strokeStyle = colour("plan-ground");
  context.stroke();
}

function drawHypothesis(context, view, one) {
  const style = colour("warn");
  context.fillStyle = context.strokeStyle = style;
  ellipse(context, view, one);
  context.globalAlpha = 0.08 + 0.3 * one.weight;
  context.fill();
  context.globalAlpha = 1;
  context.lineWidth = 1.4;
  context.stroke();
  const [x, y] = view.pixel(one.x, one.y);
  context.beginPath();
  context.arc(x, y, 3, 0, 2 * Math.PI);
  context.fill();
  haloText(context, `${Math.round(100 * one.weight)} %`, x + 6, y - 6, style);
}

/** The trajectory that the whole session tells, afterwards. */
export function smoothedLayer({ x, y, level_id: levels }) {
  return {
    visible: true, levelId: null,
    draw(context, view) {
      context.strokeStyle = colour("third");
      context.lineWidth = 2;
      context.beginPath();
      x.forEach((one, i) => {
        if (levels[i] !== this.levelId) return;
        if (levels[i - 1] === this.levelId) context.lineTo(...view.pixel(one, y[i]));
        else context.moveTo(...view.pixel(one, y[i]));
      });
      context.stroke();
    },
  };
}

/** Known positions as crosses, joined with what was told there. */
export function truthLayer(points) {
  return {
    visible: true, levelId: null, sessionLevel: null,
    draw(context, view) {
      context.lineWidth = 2;
      for (const one of points) {
        if ((one.level_id ?? this.sessionLevel ?? this.levelId) !== this.levelId) continue;
        const [x, y] = view.pixel(one.x, one.y);
        const style = colour(one.fix === null ? "soft" : one.fix.inside ? "good" : "bad");
        context.strokeStyle = style;
        context.beginPath();
        context.moveTo(x - CROSS_PX, y - CROSS_PX);
        context.lineTo(x + CROSS_PX, y + CROSS_PX);
        context.moveTo(x - CROSS_PX, y + CROSS_PX);
        context.lineTo(x + CROSS_PX, y - CROSS_PX);
        if (one.fix && one.fix.level_id === this.levelId) {
          context.moveTo(x, y);
          context.lineTo(...view.pixel(one.fix.x, one.fix.y));
        }
        context.stroke();
      }
    },
  };
}
