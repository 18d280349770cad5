// The plan of the level that a session is on, with the map's field beneath; another one when it changes the level.

import { geofenceLayer } from "../pages/level/overlays.js";
import { Rasters } from "../pages/level/quantities.js";
import { pictureLayer } from "../canvas.js";
import { heatImage, legend, rasterExtent } from "../heat.js";
import { levelPlan } from "../plans.js";
import { h, replace, toastError, toggle } from "../ui.js";
import { nowLayer, smoothedLayer, trackLayer, truthLayer } from "./layers.js";

const FIELD_ALPHA = 0.6;
const MARGIN_M = 8;

/** Plan, layers and the switches of what is shown. */
export class SessionStage {
  constructor(app, session, log) {
    Object.assign(this, { app, session, log });
    this.rasters = new Rasters(app.api);
    this.track = trackLayer(log);
    this.now = nowLayer();
    this.smoothed = null;
    this.truth = null;
    this.levelId = null;
    this.view = null;
    this.withField = true;
    /** Whether the view moves along. */
    this.following = false;
    this.caption = h("h2", {});
    this.place = h("div", {});
    this.key = h("div", {});
    this.switches = h("div", { class: "row start layers", role: "group", "aria-label": "Layers" });
    this.element = h("div", { class: "stack" }, h("div", { class: "row" }, this.caption, this.switches), this.place, this.key);
    this.#drawSwitches();
  }

  #turn = 0;
  #gone = false;

  /** Show fix `i` as now; its level comes into view. */
  async show(i) {
    const fix = this.log.fix(i);
    this.track.now = i;
    this.now.fix = fix;
    this.now.hypotheses = this.log.hypotheses(i);
    const levelId = fix?.level_id ?? this.levelId ?? this.session.level_id ?? this.session.maps[0]?.level_id;
    if (levelId && levelId !== this.levelId) await this.#open(levelId);
    if (this.following && fix?.status === "ok" && this.view) this.view.reveal(fix.x, fix.y);
    this.view?.redraw();
  }

  /** Known positions, once they are there. */
  setTruth(points) {
    const shown = this.truth?.visible ?? true;
    if (this.truth) this.view?.remove(this.truth);
    this.truth = Object.assign(truthLayer(points), { visible: shown });
    this.truth.sessionLevel = this.session.level_id;
    this.#put(this.truth);
    this.#drawSwitches();
  }

  destroy() {
    this.#gone = true;
    this.view?.destroy();
  }

  get #layers() { return [this.smoothed, this.track, this.truth, this.now].filter(Boolean); }

  async #open(levelId) {
    const turn = ++this.#turn;
    this.levelId = levelId;
    const level = await this.app.api.get(`/v1/levels/${levelId}`);
    const view = await levelPlan(this.app, level, { label: `Track on ${level.name}` });
    if (turn !== this.#turn || this.#gone) return view.destroy();
    this.view?.destroy();
    this.view = view;
    this.field = null;
    for (const layer of this.#layers) this.#put(layer);
    replace(this.caption, h("a", { href: `#/levels/${level.id}` }, level.name));
    replace(this.place, view.element);
    this.#fitSoon(view);
    this.#showField();
    this.#fences(view, levelId);
    return undefined;
  }

  // The track, not the building: a walk of twenty metres is a dot in it. A view has its size after the next frame.
  #fitSoon(view) {
    if (view !== this.view || this.#gone) return;
    if (!view.size.width) requestAnimationFrame(() => this.#fitSoon(view));
    else {
      const extent = this.log.extent(this.levelId, MARGIN_M);
      if (extent) view.fit(extent);
    }
  }

  #put(layer) {
    layer.levelId = this.levelId;
    if (this.view && !this.view.layers.includes(layer)) this.view.add(layer, layer === this.smoothed || layer === this.truth ? this.now : null);
    this.view?.redraw();
  }

  async #showField() {
    if (this.field) { this.field.visible = this.withField; this.view.redraw(); }
    if (!this.withField) return replace(this.key);
    const [view, used] = [this.view, this.session.maps.find((one) => one.level_id === this.levelId)];
    if (!used) return undefined;
    const shown = await this.rasters.get({ id: used.map_id }, "mean", { channel: "total" });
    if (view !== this.view || !this.withField) return undefined;
    replace(this.key, legend({ label: "Field of the map", ...shown }));
    if (this.field) return undefined;
    this.field = pictureLayer(heatImage(shown.raster, shown), rasterExtent(shown.raster), { alpha: FIELD_ALPHA, smooth: false });
    view.add(this.field, this.#layers[0]);
    return undefined;
  }

  async #fences(view, levelId) {
    const found = await this.app.api.find("/v1/geofences", { level_id: levelId });
    if (found?.items.length && view === this.view) view.add(geofenceLayer(found.items), this.#layers[0]);
  }

  #drawSwitches() {
    replace(
      this.switches,
      toggle("Field", this.withField, (on) => { this.withField = on; this.#showField(); }),
      toggle("95 % ellipses", this.track.ellipses, (on) => { this.track.ellipses = on; this.view?.redraw(); }),
      this.truth && toggle("Known positions", this.truth.visible, (on) => { this.truth.visible = on; this.view?.redraw(); }),
      this.#smoothedSwitch(),
    );
  }

  #smoothedSwitch() {
    const box = toggle("Smoothed", this.smoothed?.visible ?? false, async (on) => {
      try {
        if (on && !this.smoothed) {
          box.querySelector("input").disabled = true;
          const { fixes } = await this.app.api.get(`/v1/sessions/${this.session.id}/trajectory`);
          this.smoothed = smoothedLayer(fixes);
          this.#put(this.smoothed);
        }
        if (this.smoothed) this.smoothed.visible = on;
        this.view?.redraw();
      } catch (error) {
        box.querySelector("input").checked = false;
        toastError(error);
      } finally {
        box.querySelector("input").disabled = false;
      }
    });
    return box;
  }
}
