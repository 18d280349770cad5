// What is drawn over the map: survey walks, suggested lines, geofences.

import { haloText } from "../../canvas.js";
import { colour } from "../../theming.js";

/** Survey walks as lines between their waypoints. */
export function walkLayer(tracks) {
  const lines = new Path2D();
  for (const { x, y } of tracks) x.forEach((value, i) => (i ? lines.lineTo(value, y[i]) : lines.moveTo(value, y[i])));
  return {
    visible: true,
    tracks,
    draw(context, view) {
      view.inMetres(context, (metric, px) => {
        for (const [style, width] of [["plan-ground", 3], ["third", 1.3]]) {
          metric.strokeStyle = colour(style);
          metric.lineWidth = width * px;
          metric.stroke(lines);
        }
      });
      context.fillStyle = colour("third");
      const radius = Math.min(3, 0.6 * view.scale);
      for (const { x, y } of tracks) {
        x.forEach((value, i) => {
          const [px, py] = view.pixel(value, y[i]);
          context.beginPath();
          context.arc(px, py, radius, 0, 2 * Math.PI);
          context.fill();
        });
      }
    },
  };
}

/** Lines to walk next, numbered from the best; `chosen` is drawn stronger. */
export function suggestionLayer(suggestions) {
  return {
    visible: true,
    chosen: null,
    draw(context, view) {
      suggestions.forEach((one, i) => {
        const [ax, ay] = view.pixel(...one.start);
        const [bx, by] = view.pixel(...one.end);
        const strong = this.chosen === i;
        for (const [style, width] of [["plan-ground", strong ? 9 : 6], ["second", strong ? 5 : 3]]) {
          context.strokeStyle = colour(style);
          context.lineWidth = width;
          context.lineCap = "round";
          context.beginPath();
          context.moveTo(ax, ay);
          context.lineTo(bx, by);
          context.stroke();
        }
        context.textAlign = "center";
        context.textBaseline = "bottom";
        haloText(context, String(i + 1), (ax + bx) / 2, (ay + by) / 2 - 5, colour("second"));
      });
    },
  };
}

/** Named points; `editing` draws them as handles. */
export function markerLayer(markers) {
  return {
    visible: true,
    markers,
    editing: false,
    draw(context, view) {
      for (const { name, x, y } of this.markers) {
        const [px, py] = view.pixel(x, y);
        context.beginPath();
        context.arc(px, py, this.editing ? 7 : 4.5, 0, 2 * Math.PI);
        context.fillStyle = colour("fourth");
        context.strokeStyle = colour("plan-ground");
        context.lineWidth = 2;
        context.fill();
        context.stroke();
        context.textBaseline = "middle";
        haloText(context, name, px + 9, py);
      }
    },
  };
}

/** Areas that the service watches: a ring of points, or a circle. */
export function geofenceLayer(fences) {
  return {
    visible: true,
    draw(context, view) {
      context.lineWidth = 2;
      context.setLineDash([6, 4]);
      context.strokeStyle = colour("fifth");
      for (const fence of fences) {
        const ring = ringOf(fence);
        if (!ring.length) continue;
        context.beginPath();
        ring.forEach(([x, y], i) => (i ? context.lineTo(...view.pixel(x, y)) : context.moveTo(...view.pixel(x, y))));
        context.closePath();
        context.globalAlpha = 0.12;
        context.fillStyle = colour("fifth");
        context.fill();
        context.globalAlpha = 1;
        context.stroke();
        const [px, py] = view.pixel(...ring[0]);
        haloText(context, fence.name ?? "", px + 6, py - 6, colour("fifth"));
      }
    },
  };
}

/** Corners of a geofence in level metres: of its polygon, or around its circle. */
export function ringOf(fence) {
  const shape = fence.shape ?? fence.area ?? fence;
  const ring = shape.polygon ?? shape.ring ?? shape.geometry?.coordinates?.[0] ?? shape.coordinates?.[0];
  if (Array.isArray(ring)) return ring.map((point) => (Array.isArray(point) ? point : [point.x, point.y]));
  if (ring?.x) return ring.x.map((x, i) => [x, ring.y[i]]);
  const circle = shape.circle ?? shape;
  const [x, y] = circle.center ?? circle.centre ?? [circle.x, circle.y];
  if (![x, y, circle.radius_m].every(Number.isFinite)) return [];
  return Array.from({ length: 48 }, (_, i) => {
    const angle = (2 * Math.PI * i) / 48;
    return [x + circle.radius_m * Math.cos(angle), y + circle.radius_m * Math.sin(angle)];
  });
}

/** Lines of equal value, already traced. */
export function contourLayer(path) {
  return {
    visible: true,
    path,
    draw(context, view) {
      view.inMetres(context, (metric, px) => {
        metric.strokeStyle = colour("contour");
        metric.lineWidth = 0.9 * px;
        metric.stroke(this.path);
      });
    },
  };
}

/** Two pictures side by side, parted at a share of the view's width. */
export function swipeLayer(left, right, share = 0.5) {
  return {
    visible: true,
    share,
    draw(context, view) {
      const at = view.size.width * this.share;
      for (const [layer, from, to] of [[left, 0, at], [right, at, view.size.width]]) {
        context.save();
        context.beginPath();
        context.rect(from, 0, to - from, view.size.height);
        context.clip();
        layer.draw(context, view);
        context.restore();
      }
      context.strokeStyle = colour("text");
      context.lineWidth = 2;
      context.beginPath();
      context.moveTo(at, 0);
      context.lineTo(at, view.size.height);
      context.stroke();
    },
  };
}
