// Lines of walks on a plan: their waypoints joined, the chosen one on top, tried ones dashed.

import { haloText } from "../canvas.js";
import { colour } from "../theming.js";

/** A layer with `lines` and `tried` ([{id, name, x, y}]), `chosen` and `near` (ids). */
export function lineLayer() {
  return {
    visible: true, lines: [], tried: [], chosen: null, near: null,
    draw(context, view) {
      for (const line of this.lines) drawLine(context, view, line, { style: colour("accent"), width: 1.6, dots: 2 });
      for (const line of this.tried) drawLine(context, view, line, { style: colour("third"), width: 2, dots: 3, dash: [6, 4] });
      const top = this.lines.find((one) => one.id === (this.near ?? this.chosen));
      if (!top) return;
      drawLine(context, view, top, { style: colour("second"), width: 3.5, dots: 4.5 });
      const [x, y] = view.pixel(top.x[0], top.y[0]);
      const width = Math.min(context.measureText(top.name).width * 1.3, view.size.width / 2);
      haloText(context, top.name, Math.min(x + 8, view.size.width - width - 8), y - 8);
    },
    /** The id of the line nearest to a place and within so many metres; null: none. */
    nearest(place, within) {
      let best = { id: null, distance: within };
      for (const { id, x, y } of this.lines) {
        for (let i = 1; i < x.length; i += 1) {
          const distance = toSegment(place, x[i - 1], y[i - 1], x[i], y[i]);
          if (distance < best.distance) best = { id, distance };
        }
      }
      return best.id;
    },
  };
}

function drawLine(context, view, { x, y }, { style, width, dots, dash = [] }) {
  context.strokeStyle = context.fillStyle = style;
  context.lineWidth = width;
  context.lineJoin = "round";
  context.setLineDash(dash);
  context.beginPath();
  x.forEach((one, i) => context.lineTo(...view.pixel(one, y[i])));
  context.stroke();
  context.setLineDash([]);
  x.forEach((one, i) => {
    context.beginPath();
    context.arc(...view.pixel(one, y[i]), dots, 0, 2 * Math.PI);
    context.fill();
  });
}

/** Distance of a place to a stretch, m. */
export function toSegment(place, x0, y0, x1, y1) {
  const [dx, dy] = [x1 - x0, y1 - y0];
  const square = dx * dx + dy * dy;
  const along = square ? ((place.x - x0) * dx + (place.y - y0) * dy) / square : 0;
  const t = Math.min(1, Math.max(0, along));
  return Math.hypot(place.x - x0 - t * dx, place.y - y0 - t * dy);
}
