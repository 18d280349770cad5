// Sessions: the open ones as they go, the closed ones below.

import { LiveFeed } from "../overview/feed.js";
import { liveList } from "../overview/list.js";
import { ago, dateTime, duration, empty, h, loading, number, pager, problem, replace, select, shortId, table } from "../ui.js";
import { levelNames, levelOptions } from "./level_names.js";

export const title = "Sessions";

const STATES = [["", "Open and closed"], ["open", "Open"], ["closed", "Closed"]];
const FILTERS = ["status", "venue_id", "level_id", "device_id"];
const TICK_MS = 1000;

export async function render(root, params, app) {
  const [names, venues, devices] = await Promise.all([
    levelNames(app), app.api.all("/v1/venues"), app.api.all("/v1/devices", {}, { most: 1000 }),
  ]);
  const page = new SessionsPage(app, names, venues, new Map(devices.map((one) => [one.id, one.name])));
  root.append(page.element);
  page.begin();
  return () => page.destroy();
}

class SessionsPage {
  constructor(app, names, venues, devices) {
    Object.assign(this, { app, names, devices });
    this.chosen = Object.fromEntries(FILTERS.map((name) => [name, app.query.get(name) ?? ""]));
    this.words = { level: (id) => names.get(id)?.name ?? "any level", device: (id) => (id ? devices.get(id) ?? id : "–") };
    this.list = liveList(this.words, (id) => `#/sessions/${id}`);
    this.state = h("span", { class: "badge", role: "status" }, "connecting");
    this.body = h("div", {}, loading());
    this.count = h("span", { class: "soft" });
    this.open = h("section", { class: "card", "aria-label": "Open sessions" }, h("header", {}, h("h2", {}, "Open"), this.count, this.state), this.body);
    this.past = h("div", {});
    this.closed = h("section", { class: "card", "aria-label": "Closed sessions" }, h("h2", {}, "Closed"), this.past);
    const pick = (label, name, options) => select(label, options, this.chosen[name], (value) => this.#choose({ [name]: value }));
    this.element = h(
      "div",
      { class: "stack sessions" },
      h(
        "div",
        { class: "page-head" },
        h("h1", {}, "Sessions"),
        h(
          "div",
          { class: "filters wide" },
          pick("Show", "status", STATES),
          pick("Venue", "venue_id", [["", "All venues"], ...venues.map((one) => [one.id, one.name])]),
          pick("Level", "level_id", levelOptions(names, "All levels")),
          pick("Device", "device_id", [["", "All devices"], ...devices]),
        ),
      ),
      this.open,
      this.closed,
    );
    this.feed = new LiveFeed(app.api, {
      onchange: () => this.#draw(),
      onstate: (now) => replace(Object.assign(this.state, { className: `badge ${now === "open" ? "good" : "warn"}` }), now === "open" ? "live" : "reconnecting"),
    });
  }

  begin() {
    this.feed.run().catch((error) => { if (error.name !== "AbortError") replace(this.body, problem(error)); });
    this.tick = setInterval(() => { if (this.feed.sessions.size) this.#draw(); }, TICK_MS);
    this.#choose({});
  }

  destroy() { clearInterval(this.tick); }

  #choose(values) {
    Object.assign(this.chosen, values);
    this.app.setQuery(this.chosen);
    this.open.hidden = this.chosen.status === "closed";
    this.closed.hidden = this.chosen.status === "open";
    this.#draw();
    const { venue_id, level_id, device_id } = this.chosen;
    if (!this.closed.hidden) {
      this.past.replaceChildren(pager({
        pages: this.app.api.pages("/v1/sessions", { limit: 50, status: "closed", venue_id, level_id, device_id }),
        render: (items) => this.#table(items),
        empty: empty("No closed sessions", "A session that was closed stays here, to be looked at again."),
      }));
    }
  }

  #draw() {
    const wanted = [...this.feed.sessions.values()].filter((one) => ["venue_id", "level_id", "device_id"].every((name) => !this.chosen[name] || one[name] === this.chosen[name]));
    wanted.sort((a, b) => (a.session_id < b.session_id ? 1 : -1));
    this.count.textContent = number(wanted.length);
    if (!wanted.length) return replace(this.body, empty("No session is open", "Open sessions appear here as soon as a device sends."));
    if (!this.body.contains(this.list.element)) replace(this.body, this.list.element);
    this.list.update(wanted);
    return undefined;
  }

  #table(items) {
    const lasted = (one) => (new Date(one.closed_at) - new Date(one.created_at)) / 1000;
    return table(
      [
        { head: "Session", cell: (one) => h("a", { href: `#/sessions/${one.id}`, title: one.id }, shortId(one.id)) },
        { head: "Level", cell: (one) => (one.level_id ? this.words.level(one.level_id) : "any level") },
        { head: "Device", cell: (one) => this.words.device(one.device_id) },
        { head: "Segments", number: true, cell: (one) => number(one.next_seq) },
        { head: "Open for", number: true, cell: (one) => duration(lasted(one)) },
        { head: "Closed", cell: (one) => h("time", { datetime: one.closed_at, title: dateTime(one.closed_at) }, ago(one.closed_at)) },
      ],
      items,
      { caption: "Closed sessions" },
    );
  }
}
