// A plan that is moved and zoomed by mouse, touch and keyboard. Metres of the level in, pixels out; y is up.

import { h, icon } from "./ui/element.js";
import { fixed } from "./ui/format.js";
import { colour, onTheme } from "./theming.js";

const LEAST_PX_PER_M = 0.02;
const MOST_PX_PER_M = 400;
const STEP_PX = 20;
const CLICK_PX = 5;
const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };

/**
 * A view of a level. (A picture is viewed likewise, in pixels: `unit` is what the scale bar says.)
 *
 * Layers are objects with `draw(context, view)` and, if they may be switched off, `visible`; they are drawn in order.
 * The context is in CSS pixels: use `view.pixel(x, y)`, or `view.inMetres(context, draw)` for paths in metres.
 *
 *     const plan = new PlanView({ label: "Plan of F2", extent: level.extent });
 *     root.append(plan.element);
 *     plan.add(planImage(bitmap, level.extent));
 *     plan.onpoint = (place) => ...;      // {x, y} under mouse or crosshair, null: nowhere
 *     plan.onpick = ({ x, y }) => ...;    // click, tap, or Enter at the crosshair
 *     return () => plan.destroy();
 */
export class PlanView {
  constructor({ label, extent, margin = 0.04, unit = "m" }) {
    this.unit = unit;
    this.layers = [];
    this.onpoint = () => {};
    this.onpick = null;
    this.onmove = () => {};
    this.extent = extent;
    this.centre = { x: 0, y: 0 };
    this.scale = 1;
    this.size = { width: 0, height: 0 };
    this.crosshair = null;
    this.canvas = h("canvas", {
      tabindex: "0", role: "application", "aria-roledescription": "plan", "aria-label": `${label}. Arrow keys move the crosshair, plus and minus zoom, shift with arrows moves the plan, 0 shows all.`,
    });
    this.element = h("div", { class: "plan" }, this.canvas, this.#buttons());
    this.#margin = margin;
    this.#watch = new ResizeObserver(() => this.#resize());
    this.#watch.observe(this.element);
    this.#untheme = onTheme(() => this.redraw());
    this.#listen();
  }

  #margin;
  #watch;
  #untheme;
  #pending = 0;
  // Until the reader moves it, the view shows all, whatever becomes of the window.
  #showsAll = true;
  #pointers = new Map();
  #pressed = null;

  /** Put a layer on top, or below the one named; returns it. */
  add(layer, before = null) {
    const at = before === null ? -1 : this.layers.indexOf(before);
    this.layers.splice(at < 0 ? this.layers.length : at, 0, layer);
    this.redraw();
    return layer;
  }

  /** Take a layer away. */
  remove(layer) {
    this.layers = this.layers.filter((one) => one !== layer);
    this.redraw();
  }

  /** Pixels of a place. */
  pixel(x, y) {
    return [
      this.size.width / 2 + (x - this.centre.x) * this.scale,
      this.size.height / 2 - (y - this.centre.y) * this.scale,
    ];
  }

  /** Place of a pixel. */
  place(px, py) {
    return {
      x: this.centre.x + (px - this.size.width / 2) / this.scale,
      y: this.centre.y - (py - this.size.height / 2) / this.scale,
    };
  }

  /** Draw with a context that is in metres; `px` is the length of a pixel there, for line widths. */
  inMetres(context, draw) {
    context.save();
    const [x, y] = this.pixel(0, 0);
    context.translate(x, y);
    context.scale(this.scale, -this.scale);
    draw(context, 1 / this.scale);
    context.restore();
  }

  /** Show all of a rectangle; without one, of the level. */
  fit(extent = this.extent) {
    if (!this.size.width) return;
    const width = Math.max(extent.x_max - extent.x_min, 1);
    const height = Math.max(extent.y_max - extent.y_min, 1);
    const room = 1 - 2 * this.#margin;
    this.scale = Math.min((this.size.width * room) / width, (this.size.height * room) / height);
    this.centre = { x: (extent.x_min + extent.x_max) / 2, y: (extent.y_min + extent.y_max) / 2 };
    this.#moved();
    this.#showsAll = extent === this.extent;
  }

  /** Zoom about a pixel; without one, about the middle. */
  zoom(factor, px = this.size.width / 2, py = this.size.height / 2) {
    const before = this.place(px, py);
    this.scale = Math.min(MOST_PX_PER_M, Math.max(LEAST_PX_PER_M, this.scale * factor));
    const after = this.place(px, py);
    this.centre = { x: this.centre.x + before.x - after.x, y: this.centre.y + before.y - after.y };
    this.#moved();
  }

  /** Move the plan by pixels. */
  pan(dx, dy) {
    this.centre = { x: this.centre.x - dx / this.scale, y: this.centre.y + dy / this.scale };
    this.#moved();
  }

  /** Bring a place to the middle if it is out of sight. */
  reveal(x, y) {
    const [px, py] = this.pixel(x, y);
    const edge = 30;
    if (px > edge && py > edge && px < this.size.width - edge && py < this.size.height - edge) return;
    this.centre = { x, y };
    this.#moved();
  }

  /** Draw soon, once however often it is asked for. */
  redraw() {
    this.#pending ||= requestAnimationFrame(() => {
      this.#pending = 0;
      this.#draw();
    });
  }

  /** End it: call from the page's clean-up. */
  destroy() {
    cancelAnimationFrame(this.#pending);
    this.#watch.disconnect();
    this.#untheme();
  }

  #moved() {
    this.#showsAll = false;
    this.redraw();
    this.onmove();
  }

  #resize() {
    const { width, height } = this.element.getBoundingClientRect();
    if (!width || !height) return;
    const ratio = window.devicePixelRatio || 1;
    this.size = { width, height };
    this.canvas.width = Math.round(width * ratio);
    this.canvas.height = Math.round(height * ratio);
    if (this.#showsAll) this.fit();
    this.#draw();
  }

  #draw() {
    const context = this.canvas.getContext("2d");
    const ratio = this.canvas.width / this.size.width || 1;
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.fillStyle = colour("plan-ground");
    context.fillRect(0, 0, this.size.width, this.size.height);
    for (const layer of this.layers) {
      if (layer.visible === false) continue;
      context.save();
      layer.draw(context, this);
      context.restore();
    }
    this.#drawScale(context);
    if (this.crosshair && document.activeElement === this.canvas) this.#drawCrosshair(context);
  }

  #drawScale(context) {
    const wanted = 110 / this.scale;
    const power = 10 ** Math.floor(Math.log10(wanted));
    const length = [5, 2, 1].map((n) => n * power).find((n) => n <= wanted) ?? power;
    const width = length * this.scale;
    const [x, y] = [14, this.size.height - 16];
    context.font = "12px system-ui, sans-serif";
    context.textBaseline = "bottom";
    for (const [style, line] of [[colour("plan-ground"), 5], [colour("text"), 1.5]]) {
      context.strokeStyle = style;
      context.lineWidth = line;
      context.beginPath();
      context.moveTo(x, y - 5);
      context.lineTo(x, y);
      context.lineTo(x + width, y);
      context.lineTo(x + width, y - 5);
      context.stroke();
      if (line > 2) context.strokeText(`${length} ${this.unit}`, x + 6, y - 4);
    }
    context.fillStyle = colour("text");
    context.fillText(`${length} ${this.unit}`, x + 6, y - 4);
  }

  #drawCrosshair(context) {
    const [x, y] = this.pixel(this.crosshair.x, this.crosshair.y);
    for (const [style, line] of [[colour("plan-ground"), 4], [colour("text"), 1.5]]) {
      context.strokeStyle = style;
      context.lineWidth = line;
      context.beginPath();
      for (const [dx, dy] of [[1, 0], [-1, 0], [0, 1], [0, -1]]) {
        context.moveTo(x + 4 * dx, y + 4 * dy);
        context.lineTo(x + 14 * dx, y + 14 * dy);
      }
      context.stroke();
    }
  }

  #buttons() {
    const button = (name, words, act) => h("button", { type: "button", "aria-label": words, title: words, onclick: act }, icon(name));
    return h(
      "div",
      { class: "plan-buttons", role: "group", "aria-label": "Zoom" },
      button("plus", "Zoom in", () => this.zoom(1.5)),
      button("minus", "Zoom out", () => this.zoom(1 / 1.5)),
      button("fit", "Show all", () => this.fit()),
    );
  }

  #listen() {
    const canvas = this.canvas;
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      const { px, py } = this.#at(event);
      this.zoom(Math.exp(-event.deltaY * (event.deltaMode ? 0.05 : 0.0015)), px, py);
    }, { passive: false });
    canvas.addEventListener("pointerdown", (event) => this.#down(event));
    canvas.addEventListener("pointermove", (event) => this.#move(event));
    canvas.addEventListener("pointerup", (event) => this.#up(event));
    canvas.addEventListener("pointercancel", (event) => { this.#pointers.delete(event.pointerId); this.#pressed = null; });
    canvas.addEventListener("pointerleave", () => { if (!this.#pointers.size) this.onpoint(null); });
    canvas.addEventListener("keydown", (event) => this.#key(event));
    canvas.addEventListener("focus", () => this.redraw());
    canvas.addEventListener("blur", () => this.redraw());
  }

  #at(event) {
    const box = this.canvas.getBoundingClientRect();
    return { px: event.clientX - box.left, py: event.clientY - box.top };
  }

  #down(event) {
    this.canvas.setPointerCapture(event.pointerId);
    const at = this.#at(event);
    this.#pointers.set(event.pointerId, at);
    this.#pressed = this.#pointers.size === 1 ? { ...at, held: this.ongrab?.(this.place(at.px, at.py), this) ?? null } : null;
  }

  #move(event) {
    const at = this.#at(event);
    const before = this.#pointers.get(event.pointerId);
    if (!before) return this.onpoint(this.place(at.px, at.py));
    const others = [...this.#pointers].filter(([id]) => id !== event.pointerId).map(([, one]) => one);
    this.#pointers.set(event.pointerId, at);
    if (this.#pressed?.held) {
      this.#pressed.held.drag(this.place(at.px, at.py));
    } else if (others.length === 1) {
      const [other] = others;
      const spread = (one) => Math.hypot(one.px - other.px, one.py - other.py) || 1;
      this.pan((at.px - before.px) / 2, (at.py - before.py) / 2);
      this.zoom(spread(at) / spread(before), (at.px + other.px) / 2, (at.py + other.py) / 2);
    } else {
      this.pan(at.px - before.px, at.py - before.py);
    }
    return undefined;
  }

  #up(event) {
    this.#pointers.delete(event.pointerId);
    const pressed = this.#pressed;
    this.#pressed = null;
    if (!pressed) return;
    const { px, py } = this.#at(event);
    if (pressed.held) pressed.held.drop?.(this.place(px, py));
    else if (Math.hypot(px - pressed.px, py - pressed.py) <= CLICK_PX) {
      this.onpoint(this.place(px, py));
      this.onpick?.(this.place(px, py));
    }
  }

  #key(event) {
    const arrow = ARROWS[event.key];
    if (arrow && event.shiftKey) this.pan(-arrow[0] * 3 * STEP_PX, -arrow[1] * 3 * STEP_PX);
    else if (arrow) this.#moveCrosshair(arrow);
    else if (event.key === "+" || event.key === "=") this.#zoomAtCrosshair(1.5);
    else if (event.key === "-") this.#zoomAtCrosshair(1 / 1.5);
    else if (event.key === "0" || event.key === "Home") this.fit();
    else if (event.key === "Enter" && this.crosshair) this.onpick?.(this.crosshair);
    else return;
    event.preventDefault();
  }

  #moveCrosshair([dx, dy]) {
    const step = STEP_PX / this.scale;
    const from = this.crosshair ?? this.centre;
    this.crosshair = { x: from.x + dx * step, y: from.y - dy * step };
    this.reveal(this.crosshair.x, this.crosshair.y);
    this.onpoint(this.crosshair);
    this.redraw();
  }

  #zoomAtCrosshair(factor) {
    const [px, py] = this.crosshair ? this.pixel(this.crosshair.x, this.crosshair.y) : [undefined, undefined];
    this.zoom(factor, px, py);
  }
}

/** A picture stretched over a rectangle in metres; its first row is the highest y. */
export function pictureLayer(image, extent, { alpha = 1, smooth = true } = {}) {
  return {
    visible: true, image, extent, alpha,
    draw(context, view) {
      const { x_min, x_max, y_min, y_max } = this.extent;
      const [left, top] = view.pixel(x_min, y_max);
      const [right, bottom] = view.pixel(x_max, y_min);
      context.globalAlpha = this.alpha;
      context.imageSmoothingEnabled = smooth;
      context.drawImage(this.image, left, top, right - left, bottom - top);
    },
  };
}

/** GeoJSON in level metres: outlines, with areas lightly filled. */
export function vectorLayer(collection) {
  const areas = new Path2D();
  const ways = new Path2D();
  for (const feature of collection.features ?? []) trace(feature.geometry, areas, ways);
  return {
    visible: true,
    draw(context, view) {
      view.inMetres(context, (metric, px) => {
        metric.fillStyle = colour("plan-fill");
        metric.strokeStyle = colour("plan-line");
        metric.lineWidth = px;
        metric.fill(areas, "evenodd");
        metric.stroke(areas);
        metric.lineWidth = 1.5 * px;
        metric.stroke(ways);
      });
    },
  };
}

function trace(geometry, areas, ways) {
  if (!geometry) return;
  const { type, coordinates } = geometry;
  const line = (path, points, close) => {
    points.forEach(([x, y], i) => (i ? path.lineTo(x, y) : path.moveTo(x, y)));
    if (close) path.closePath();
  };
  if (type === "Polygon") coordinates.forEach((ring) => line(areas, ring, true));
  else if (type === "MultiPolygon") coordinates.flat().forEach((ring) => line(areas, ring, true));
  else if (type === "LineString") line(ways, coordinates, false);
  else if (type === "MultiLineString") coordinates.forEach((one) => line(ways, one, false));
  else if (type === "GeometryCollection") geometry.geometries.forEach((one) => trace(one, areas, ways));
}

/** Text with a halo of the ground, readable over anything. */
export function haloText(context, text, x, y, style = colour("text")) {
  context.font = "600 12px system-ui, sans-serif";
  context.lineWidth = 3.5;
  context.lineJoin = "round";
  context.strokeStyle = colour("plan-ground");
  context.strokeText(text, x, y);
  context.fillStyle = style;
  context.fillText(text, x, y);
}

/** A place as text. */
export function placeText({ x, y }) {
  return `x ${fixed(x, 1)} m, y ${fixed(y, 1)} m`;
}
