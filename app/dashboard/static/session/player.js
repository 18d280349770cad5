// Time of a session: a strip of its status, and a player that goes through it or follows what comes.

import { statusColour, STATUS_WORDS as WORDS } from "../overview/marks.js";
import { colour, onTheme } from "../theming.js";
import { duration, h, icon, replace, select, timeOfDay } from "../ui.js";
import { statusRuns } from "./fixes.js";

const SPEEDS = [1, 2, 5, 10, 30, 100];
const FRAME_MS = 50;

/** Play, pause, speed, scrub, live. `onchange(index)` whenever another fix is the one of now. */
export class Player {
  constructor(log, { live, onchange }) {
    Object.assign(this, { log, onchange });
    this.live = live;
    this.following = live;
    this.speed = 10;
    this.t = 0;
    this.index = -2;
    this.timer = 0;
    this.button = h("button", { type: "button", class: "primary play", onclick: () => (this.timer ? this.pause() : this.play()) });
    this.slider = h("input", { type: "range", min: 0, max: 1, step: 0.1, value: 0, "aria-label": "Time", oninput: () => this.seek(log.start + 1000 * this.slider.valueAsNumber) });
    this.clock = h("span", { class: "clock" });
    this.liveButton = h("button", { type: "button", class: "small", hidden: !live, onclick: () => this.follow() }, icon("live"), "Live");
    this.strip = statusStrip(log, (share) => this.seek(log.start + share * (log.end - log.start)));
    this.element = h(
      "div",
      { class: "stack player" },
      h("div", { class: "row start" }, this.button, select("Speed", SPEEDS.map((one) => [one, `${one}×`]), this.speed, (value) => { this.speed = Number(value); }), this.slider, this.clock, this.liveButton),
      this.strip.element,
    );
    this.#label();
  }

  get playing() { return Boolean(this.timer); }

  /** New fixes are there. */
  grown() {
    this.slider.max = Math.max(0.1, (this.log.end - this.log.start) / 1000);
    this.strip.redraw();
    if (this.following) this.#show(this.log.end);
    else this.#tell();
  }

  /** The session was closed: nothing comes any more. */
  ended() {
    this.live = false;
    this.following = false;
    this.liveButton.hidden = true;
    this.#label();
  }

  play() {
    if (this.t >= this.log.end) this.#show(this.log.start);
    this.following = false;
    let before = performance.now();
    this.timer = setInterval(() => {
      const now = performance.now();
      this.#show(Math.min(this.log.end, this.t + (now - before) * this.speed));
      before = now;
      if (this.t < this.log.end) return;
      this.pause();
      if (this.live) this.follow();
    }, FRAME_MS);
    this.#label();
  }

  pause() {
    clearInterval(this.timer);
    this.timer = 0;
    this.#label();
  }

  /** Show the fix of a time, Unix milliseconds. */
  seek(t) {
    this.following = false;
    this.#show(t);
    this.#label();
  }

  /** Show the newest fix from now on. */
  follow() {
    this.pause();
    this.following = true;
    this.#show(this.log.end);
    this.#label();
  }

  destroy() {
    clearInterval(this.timer);
    this.strip.destroy();
  }

  #show(t) {
    this.t = t;
    this.#tell();
    const index = this.log.at(t);
    if (index === this.index) return;
    this.index = index;
    this.onchange(index);
  }

  #tell() {
    const [gone, all] = [(this.t - this.log.start) / 1000, (this.log.end - this.log.start) / 1000];
    const words = this.log.length ? `${duration(Math.max(0, gone))} of ${duration(all)}` : "no position yet";
    if (this.clock.textContent !== words) this.clock.textContent = words;
    this.clock.title = this.log.length ? timeOfDay(this.t) : "";
    this.slider.value = gone;
    this.slider.setAttribute("aria-valuetext", words);
    this.strip.setNow(this.log.length > 1 ? gone / all : 0);
  }

  #label() {
    const on = this.playing;
    replace(this.button, icon(on ? "pause" : "play"), on ? "Pause" : "Play");
    this.liveButton.setAttribute("aria-pressed", String(this.following));
  }
}

// Status over time: a colour a stretch, full where it is sure.
function statusStrip(log, onpick) {
  const canvas = h("canvas", { class: "strip", role: "img" });
  const key = h("div", { class: "row start strip-key" });
  const element = h("div", { class: "stack" }, canvas, key);
  let now = 0;
  let pending = 0;
  let shown = "";
  const draw = () => {
    pending = 0;
    const { width, height } = canvas.getBoundingClientRect();
    const ratio = window.devicePixelRatio || 1;
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
    const context = canvas.getContext("2d");
    context.scale(ratio, ratio);
    const span = Math.max(1, log.end - log.start);
    const x = (i) => ((log.columns.t_ms[i] - log.start) / span) * width;
    for (const [from, to, name] of statusRuns(log.columns)) {
      const [status, sure] = name.split(" ");
      context.fillStyle = colour(statusColour(status));
      context.globalAlpha = sure || status !== "ok" ? 1 : 0.45;
      context.fillRect(x(from), 0, Math.max(1, x(Math.min(to + 1, log.length - 1)) - x(from)), height);
    }
    context.globalAlpha = 1;
    context.fillStyle = colour("text");
    context.fillRect(Math.min(width - 2, now * width), 0, 2, height);
    tell();
  };
  const tell = () => {
    const counts = new Map();
    log.columns.status.forEach((name, i) => {
      const key_ = name === "ok" && log.columns.sure[i] ? "sure" : name;
      counts.set(key_, (counts.get(key_) ?? 0) + 1);
    });
    const shares = [...counts].map(([name, n]) => [name, Math.round((100 * n) / log.length)]);
    const words = shares.map(([name, share]) => `${name === "sure" ? "sure" : WORDS[name]} ${share} %`).join(", ");
    if (words === shown) return;
    shown = words;
    canvas.setAttribute("aria-label", `Status over time: ${words}`);
    replace(key, shares.map(([name, share]) => h("span", {}, swatch(name), `${name === "sure" ? "sure" : WORDS[name]} ${share}\u202f%`)));
  };
  const redraw = () => { pending ||= requestAnimationFrame(draw); };
  canvas.addEventListener("click", (event) => onpick(event.offsetX / canvas.getBoundingClientRect().width));
  const size = new ResizeObserver(redraw);
  size.observe(canvas);
  const untheme = onTheme(redraw);
  return {
    element,
    redraw,
    setNow(share) { now = share; redraw(); },
    destroy() { cancelAnimationFrame(pending); size.disconnect(); untheme(); },
  };
}

function swatch(name) {
  return h("i", { class: `swatch ${name === "sure" || name === "ok" ? "accent" : statusColour(name)}${name === "ok" ? " half" : ""}`, "aria-hidden": "true" });
}
