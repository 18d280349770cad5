// The plan with the map on it: what is shown, its colours, the value under the pointer, contours.

import { pictureLayer, placeText } from "../../canvas.js";
import { contourPath } from "../../contours.js";
import { heatImage, legend, rasterExtent, roundSteps, valueAt } from "../../heat.js";
import { h, number, problem, replace, select, toggle, unit } from "../../ui.js";
import { contourLayer } from "./overlays.js";
import { HEADINGS, QUANTITIES, Rasters, channelsOf } from "./quantities.js";

const NOTHING = "none";

// The view draws in the next frame; what is asked for here afterwards comes after it.
const afterDrawing = requestAnimationFrame;

/** The view of one level and the controls of what it shows. */
export class Stage {
  constructor(app, view) {
    this.app = app;
    this.view = view;
    this.rasters = new Rasters(app.api);
    this.map = null;
    this.shown = null;
    this.what = app.query.get("show") ?? "mean";
    this.channel = app.query.get("channel") ?? "total";
    this.heading = "0";
    this.heat = null;
    this.contours = null;
    this.wantsContours = false;
    this.readout = h("p", { class: "readout", role: "status", "aria-live": "off" }, "Point at the plan, or move the crosshair with the arrow keys.");
    this.key = h("div", {});
    this.controls = h("div", { class: "row start stage-controls" });
    this.trouble = h("div", {});
    view.onpoint = (place) => this.#point(place);
    this.element = h("div", { class: "stack" }, this.controls, this.trouble, view.element, h("div", { class: "row stage-foot" }, this.readout, this.key));
  }

  #turn = 0;

  /** Show another map version; null: the plan only. */
  async setMap(map) {
    this.map = map;
    if (map && !channelsOf(map).some(([name]) => name === this.channel)) this.channel = "total";
    if (!(this.what in QUANTITIES) && this.what !== NOTHING) this.what = "mean";
    this.#drawControls();
    await this.refresh();
  }

  /** Load and draw what is chosen. */
  async refresh() {
    const turn = ++this.#turn;
    replace(this.trouble);
    const began = performance.now();
    this.view.element.setAttribute("aria-busy", "true");
    try {
      const shown = this.map && this.what !== NOTHING ? await this.rasters.get(this.map, this.what, this) : null;
      if (turn === this.#turn) this.#put(shown);
      if (shown) afterDrawing(() => performance.measure("isodyn.map", { start: began, detail: { nodes: shown.raster.values.length } }));
    } catch (error) {
      if (error.name === "AbortError" || turn !== this.#turn) return;
      this.#put(null);
      replace(this.trouble, problem(error));
    } finally {
      if (turn === this.#turn) this.view.element.removeAttribute("aria-busy");
    }
  }

  /** Show something else in place of the map until called with null (a comparison of versions). */
  setAlternative(layer, { key = null, values = null } = {}) {
    if (this.alternative) this.view.remove(this.alternative);
    this.alternative = layer && this.view.add(layer, this.#above());
    this.values = values;
    if (this.heat) this.heat.visible = !layer;
    if (this.contours) this.contours.visible = !layer && this.wantsContours;
    this.controls.hidden = Boolean(layer);
    replace(this.key, layer ? key : this.#legend());
    this.view.redraw();
  }

  /** A picture of a raster for the plan. */
  static picture({ raster, low, high, colours }) {
    return pictureLayer(heatImage(raster, { low, high, colours }), rasterExtent(raster), { alpha: 0.86, smooth: false });
  }

  #put(shown) {
    for (const layer of [this.heat, this.contours]) if (layer) this.view.remove(layer);
    this.shown = shown;
    this.heat = shown && this.view.add(Stage.picture(shown), this.#above());
    this.contours = null;
    this.#contour();
    if (this.alternative) this.heat.visible = false;
    else replace(this.key, this.#legend());
    this.view.redraw();
  }

  #legend() {
    return this.shown && legend({ label: this.shown.words, ...this.shown });
  }

  #contour() {
    if (this.contours) this.contours.visible = this.wantsContours && !this.alternative;
    else if (this.wantsContours && this.shown && !this.alternative) {
      const { raster, low, high } = this.shown;
      this.contours = this.view.add(contourLayer(contourPath(raster, roundSteps(low, high, 8))), this.#above());
    }
    this.view.redraw();
  }

  // Maps lie over the plan's pictures, under everything else.
  #above() {
    const below = [this.view.picture, this.view.vector, this.heat, this.contours, this.alternative];
    return this.view.layers.find((layer) => !below.includes(layer)) ?? null;
  }

  #drawControls() {
    if (!this.map) return replace(this.controls);
    const shows = [...Object.entries(QUANTITIES).map(([name, { words }]) => [name, words]), [NOTHING, "Plan only"]];
    const component = select("Component", channelsOf(this.map), this.channel, (name) => {
      this.channel = name;
      this.app.setQuery({ channel: name });
      this.refresh();
    });
    const heading = select("Heading", HEADINGS, this.heading, (name) => {
      this.heading = name;
      this.refresh();
    });
    const only = () => {
      component.hidden = !QUANTITIES[this.what]?.channels;
      heading.hidden = !QUANTITIES[this.what]?.headings;
    };
    only();
    const show = select("Show", shows, this.what, (name) => {
      this.what = name;
      only();
      this.app.setQuery({ show: name });
      this.refresh();
    });
    return replace(this.controls, show, component, heading, toggle("Contours", this.wantsContours, (on) => {
      this.wantsContours = on;
      this.#contour();
    }));
  }

  #point(place) {
    if (!place) return;
    const values = this.values?.(place) ?? (this.shown && !this.alternative ? [["", this.#valueText(place)]] : []);
    replace(this.readout, values.map(([name, text]) => [name && `${name} `, h("b", {}, text), " "]), " at ", placeText(place));
    // Spoken only when the crosshair is moved: a mouse passes more places than anyone can listen to.
    if (document.activeElement === this.view.canvas && this.view.crosshair === place) this.app.announce(this.readout.textContent);
  }

  #valueText(place) {
    const value = valueAt(this.shown.raster, place);
    if (!Number.isFinite(value)) return "not mapped";
    return this.shown.value?.(value) ?? (this.shown.unit ? unit(value, this.shown.unit) : number(value));
  }
}
