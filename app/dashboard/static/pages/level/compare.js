// Two versions side by side: swiped over each other, or their difference.

import { TABLES, colourRange, legend, valueAt } from "../../heat.js";
import { choices, facts, h, problem, replace, select, toggle, unit } from "../../ui.js";
import { swipeLayer } from "./overlays.js";
import { Stage } from "./stage.js";

const LEAST_UT = 1;

/** The panel under the plan while two versions are compared. */
export class Comparison {
  constructor(app, stage, maps, onclose) {
    this.app = app;
    this.stage = stage;
    this.maps = maps;
    this.mode = "swipe";
    this.significant = false;
    this.share = 0.5;
    this.body = h("div", { class: "stack" });
    this.element = h("section", { class: "card compare", "aria-label": "Compare versions", hidden: true }, this.body);
    this.onclose = onclose;
  }

  #turn = 0;

  /** Compare a version with the current one, or with the one before it. */
  open(map, current) {
    const index = this.maps.indexOf(map);
    this.now = map;
    this.then = current && current !== map ? current : (this.maps[index + 1] ?? this.maps[index - 1]);
    if (this.then.version > this.now.version) [this.now, this.then] = [this.then, this.now];
    this.element.hidden = false;
    this.#controls();
    this.element.scrollIntoView({ block: "nearest" });
    return this.#draw();
  }

  /** Back to one version. */
  close() {
    this.#turn += 1;
    this.element.hidden = true;
    this.stage.setAlternative(null);
    this.onclose();
  }

  #controls() {
    const options = this.maps.map((map) => [map.id, `Version ${map.version}`]);
    const pick = (name) => (id) => {
      this[name] = this.maps.find((map) => map.id === id);
      this.#draw();
    };
    const slider = h("input", {
      type: "range", min: 0, max: 1, step: 0.01, value: this.share, "aria-label": "Where the older version ends and the newer begins",
      oninput: () => {
        this.share = slider.valueAsNumber;
        if (this.swipe) this.swipe.share = this.share;
        this.stage.view.redraw();
      },
    });
    const swipeOnly = h("div", { class: "swipe" }, h("span", {}, "older"), slider, h("span", {}, "newer"));
    const strict = toggle("Over its uncertainty", this.significant, (on) => { this.significant = on; this.#draw(); });
    const only = () => {
      swipeOnly.hidden = this.mode !== "swipe";
      strict.hidden = this.mode !== "difference";
    };
    only();
    this.numbers = h("div", {});
    replace(
      this.body,
      h("header", { class: "row" }, h("h2", {}, "Compare versions"), h("button", { type: "button", onclick: () => this.close() }, "End comparison")),
      h(
        "div",
        { class: "row start" },
        select("Older", options, this.then.id, pick("then")),
        select("Newer", options, this.now.id, pick("now")),
        choices("See", [["swipe", "Swipe"], ["difference", "Difference"]], this.mode, (mode) => { this.mode = mode; only(); this.#draw(); }),
        strict,
      ),
      swipeOnly,
      this.numbers,
    );
  }

  async #draw() {
    const turn = ++this.#turn;
    try {
      const put = this.mode === "swipe" ? await this.#swipe() : await this.#difference();
      if (turn !== this.#turn) return;
      put();
      await this.#summary(turn);
    } catch (error) {
      if (error.name !== "AbortError" && turn === this.#turn) replace(this.numbers, problem(error));
    }
  }

  async #swipe() {
    const [then, now] = await Promise.all([this.then, this.now].map((map) => this.stage.rasters.get(map, "mean", { channel: "total" })));
    const range = { low: Math.min(then.low, now.low), high: Math.max(then.high, now.high) };
    return () => {
      this.swipe = swipeLayer(Stage.picture({ ...then, ...range }), Stage.picture({ ...now, ...range }), this.share);
      const text = (shown, place) => {
        const value = valueAt(shown.raster, place);
        return Number.isFinite(value) ? unit(value, "µT") : "not mapped";
      };
      this.stage.setAlternative(this.swipe, {
        key: legend({ label: now.words, unit: "µT", ...range }),
        values: (place) => [[`Version ${this.then.version}`, text(then, place)], [`${this.now.version}`, text(now, place)]],
      });
    };
  }

  async #difference() {
    const statistic = this.significant ? "significance" : "change";
    const raster = await this.app.api.raster(`/v1/maps/${this.now.id}/diff`, { against: this.then.id, component: "total", statistic });
    const range = colourRange(raster.values, { symmetric: true, least: this.significant ? 2 : LEAST_UT });
    const name = this.significant ? "" : "µT";
    return () => this.stage.setAlternative(Stage.picture({ raster, ...range, colours: TABLES.apart }), {
      key: legend({ label: this.significant ? "Change over its standard deviation" : "Change of the total field", unit: name, ...range, colours: TABLES.apart }),
      values: (place) => {
        const value = valueAt(raster, place);
        return [["Change", Number.isFinite(value) ? (name ? unit(value, name) : unit(value, "sd")) : "not mapped in both"]];
      },
    });
  }

  async #summary(turn) {
    const diff = await this.app.api.get(`/v1/maps/${this.now.id}/diff`, { against: this.then.id });
    if (turn !== this.#turn) return;
    const area = ({ area_m2: value }) => unit(value, "m²");
    const all = diff.change.find((one) => one.component === "all") ?? diff.change[0];
    replace(this.numbers, diff.identical ? h("p", {}, "Both versions have the same content.") : facts([
      ["Mapped in both", area(diff.compared)],
      [`Changed by more than ${diff.least_ut} µT`, area(diff.changed)],
      ["Of these beyond their uncertainty", area(diff.significant)],
      ["Newly mapped", area(diff.newly_mapped)],
      ["No longer mapped", area(diff.no_longer_mapped)],
      ["Typical change (rms)", all && unit(all.rms, "µT")],
      ["Largest change", all && unit(all.largest, "µT")],
      ["Walks added / taken out", `${diff.sources.n_added} / ${diff.sources.n_removed}`],
    ]));
  }
}
