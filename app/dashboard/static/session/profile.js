// The field that was measured along the track beside the map's.

import { chart } from "../charts.js";
import { choices, empty, h, percent, problem, replace, unit } from "../ui.js";

const CHANNELS = [["total", "Total"], ["h", "Horizontal"], ["v", "Vertical"]];
const FRESH_MS = 5000;
const CURSOR_MS = 200;

/** The card; `update()` reads it anew (at most every few seconds), `setNow(t)` moves the cursor. */
export class ProfileCard {
  constructor(app, session) {
    Object.assign(this, { app, session });
    this.channel = "total";
    this.data = null;
    this.onlearned = () => {};
    this.place = h("div", {});
    this.said = h("p", { class: "soft small" });
    this.element = h(
      "section",
      { class: "card", "aria-label": "Field along the track" },
      h("header", {}, h("h2", {}, "Field along the track"), choices("Component", CHANNELS, this.channel, (name) => { this.channel = name; this.#draw(); })),
      this.place,
      this.said,
    );
    this.element.querySelector("legend").classList.add("visually-hidden");
  }

  #last = 0;
  #timer = 0;
  #cursor = 0;
  #gone = false;
  #chart = null;

  /** Read the profile soon: not more often than every few seconds, however many segments come. */
  update() {
    this.#timer ||= setTimeout(() => { this.#timer = 0; this.#read(); }, Math.max(0, this.#last + FRESH_MS - Date.now()));
  }

  /** The time shown on the plan, Unix milliseconds. */
  setNow(t) {
    this.now = t;
    this.#cursor ||= setTimeout(() => { this.#cursor = 0; if (this.#chart) this.#chart.update({ layout: this.#layout() }); }, CURSOR_MS);
  }

  destroy() {
    this.#gone = true;
    clearTimeout(this.#timer);
    clearTimeout(this.#cursor);
    this.#chart?.destroy();
  }

  async #read() {
    this.#last = Date.now();
    try {
      this.data = await this.app.api.get(`/v1/sessions/${this.session.id}/profile`);
      if (this.#gone) return;
      this.onlearned(this.data);
      this.#draw();
    } catch (error) {
      if (error.name !== "AbortError") replace(this.place, problem(error));
    }
  }

  #draw() {
    if (!this.data) return;
    if (this.data.number.length < 2) {
      replace(this.place, empty("No profile yet", "It begins with the first positions."));
      return;
    }
    const [traces, layout] = [this.#traces(), this.#layout()];
    if (this.#chart) this.#chart.update({ traces, layout });
    else {
      this.#chart = chart({ label: "Field along the track, measured and of the map", traces, layout, height: 280 });
      replace(this.place, this.#chart.element);
    }
    replace(this.said, this.#words());
  }

  #seconds(t) { return (t - this.data.t_ms[0]) / 1000; }

  #traces() {
    const [measured, mapped, sd] = ["measured", "mapped", "sd"].map((part) => this.data[part][this.channel]);
    const x = this.data.t_ms.map((t) => this.#seconds(t));
    return [
      { x, y: measured, name: "measured", mode: "lines", line: { width: 1.8 } },
      { x, y: mapped, name: "map", mode: "lines", line: { width: 1.6, dash: "dot" } },
      { ...band(x, mapped, sd), mode: "lines", line: { width: 0 }, name: "map ± deviation", fill: "toself", fillcolor: "rgba(120, 140, 140, 0.22)", hoverinfo: "skip" },
    ];
  }

  #layout() {
    const at = this.now === undefined ? [] : [this.#seconds(this.now)];
    return {
      showlegend: true,
      xaxis: { title: { text: "time since the start, s" } },
      yaxis: { title: { text: "field, µT" } },
      shapes: at.map((x) => ({ type: "line", xref: "x", yref: "paper", x0: x, x1: x, y0: 0, y1: 1, line: { width: 1, dash: "dash", color: "gray" } })),
    };
  }

  #words() {
    const [measured, mapped, sd] = ["measured", "mapped", "sd"].map((part) => this.data[part][this.channel]);
    const apart = measured.flatMap((value, i) => (value === null || mapped[i] === null ? [] : [[Math.abs(value - mapped[i]), sd[i]]]));
    if (!apart.length) return "The track lies where nothing is mapped.";
    const middle = apart.map(([one]) => one).sort((a, b) => a - b)[Math.floor(apart.length / 2)];
    const within = apart.filter(([one, spread]) => one <= 2 * spread).length / apart.length;
    const known = this.data.calibration ? "" : " What the device itself adds is not known yet.";
    return `Typically ${unit(middle, "µT")} apart; ${percent(within)} within two deviations.${known}`;
  }
}

// Outlines of the stretches where the map is known: along their lower edge and back along the upper one.
function band(x, mapped, sd) {
  const outline = { x: [], y: [] };
  for (let from = 0; from < x.length; from += 1) {
    if (mapped[from] === null) continue;
    let to = from;
    while (to + 1 < x.length && mapped[to + 1] !== null) to += 1;
    for (let i = from; i <= to; i += 1) { outline.x.push(x[i]); outline.y.push(mapped[i] - sd[i]); }
    for (let i = to; i >= from; i -= 1) { outline.x.push(x[i]); outline.y.push(mapped[i] + sd[i]); }
    outline.x.push(null);
    outline.y.push(null);
    from = to;
  }
  return outline;
}
