// Operations: how the service does, in tables and charts that can be narrowed down and taken home.

import { levelNames } from "./level_names.js";
import { SECTIONS } from "../operations/sections.js";
import { download, fill, h, icon, select, toastError } from "../ui.js";

export const title = "Operations";

const SPANS = {
  hour: { text: "Last hour", ms: 3_600_000, bucket: "minute" },
  day: { text: "Last day", ms: 86_400_000, bucket: "hour" },
  week: { text: "Last 7 days", ms: 7 * 86_400_000, bucket: "hour" },
  month: { text: "Last 30 days", ms: 30 * 86_400_000, bucket: "day" },
};
const FILTERS = ["venue_id", "level_id", "device_id", "method"];
const APART = { level: ["Level", "level_id"], device: ["Device", "device_id"], method: ["Method", "method"] };

export async function render(root, params, app) {
  const names = await loadNames(app);
  const chosen = { span: SPANS[app.query.get("span")] ? app.query.get("span") : "day" };
  chosen.by = APART[app.query.get("by")] ? app.query.get("by") : "level";
  for (const name of FILTERS) chosen[name] = app.query.get(name);
  const charts = new Map();
  const cards = SECTIONS.map((section) => ({ section, body: h("div", { class: "stack" }) }));
  const draw = () => {
    app.setQuery({ ...chosen, span: chosen.span === "day" ? null : chosen.span, by: chosen.by === "level" ? null : chosen.by });
    for (const { section, body } of cards) show(app, section, body, chosen, names, charts);
  };
  root.append(
    h("div", { class: "page-head" }, h("h1", {}, "Operations"), h("button", { type: "button", onclick: draw }, "Refresh")),
    filters(chosen, names, draw),
    h("div", { class: "stack" }, cards.map(({ section, body }) => h(
      "section",
      { class: "card", "aria-label": section.heading },
      h("header", {}, h("h2", {}, section.heading), csvOf(app, section, chosen)),
      body,
    ))),
  );
  draw();
  return () => { for (const list of charts.values()) list.forEach((one) => one.destroy()); };
}

async function loadNames(app) {
  const [venues, levels, devices, methods] = await Promise.all([
    app.api.all("/v1/venues", {}, { most: 1000 }),
    levelNames(app),
    app.api.all("/v1/devices", {}, { most: 1000 }),
    app.api.get("/v1/methods"),
  ]);
  const called = (items) => new Map(items.map((one) => [one.id, one.name]));
  return {
    venue_id: called(venues), level_id: new Map([...levels].map(([id, { name }]) => [id, name])), device_id: called(devices),
    method: new Map(methods.items.map((one) => [one.name, one.name])),
  };
}

function filters(chosen, names, draw) {
  const change = (name) => (value) => { chosen[name] = value || null; draw(); };
  const words = { venue_id: "Venue", level_id: "Level", device_id: "Device", method: "Method" };
  const one = (name) => select(words[name], [["", "All"], ...names[name]], chosen[name] ?? "", change(name));
  return h(
    "section",
    { class: "card filters", "aria-label": "Filters" },
    select("Time", Object.entries(SPANS).map(([key, { text }]) => [key, text]), chosen.span, change("span")),
    FILTERS.map(one),
    select("Fixes and errors by", Object.entries(APART).map(([key, [text]]) => [key, text]), chosen.by, change("by")),
  );
}

/** What a section is asked with: its own filters only. */
function queryOf(section, chosen) {
  const span = SPANS[chosen.span];
  const all = { since: new Date(Date.now() - span.ms).toISOString(), bucket: span.bucket, ...chosen };
  return { by: section.told ? chosen.by : null, ...Object.fromEntries(section.takes.map((name) => [name, all[name]])) };
}

function show(app, section, body, chosen, names, charts) {
  charts.get(section)?.forEach((one) => one.destroy());
  const mine = [];
  charts.set(section, mine);
  const context = {
    by: apart(chosen.by, names),
    level: (id) => names.level_id.get(id),
    keep: (chart) => { mine.push(chart); return chart; },
  };
  fill(body, async () => {
    const answer = await app.api.get(`/v1/stats/${section.name}`, queryOf(section, chosen));
    const shown = [section.show(answer, context)].flat();
    return answer.complete_since
      ? [h("p", { class: "badge warn" }, `Complete only since ${new Date(answer.complete_since).toLocaleString()}: more was stored than one question reads`), ...shown]
      : shown;
  });
}

function apart(by, names) {
  const [head, column] = APART[by];
  return { head, name: (row) => names[column].get(row[column]) ?? row[column] ?? "none named" };
}

function csvOf(app, section, chosen) {
  const get = async () => {
    try {
      download(`${section.name}.csv`, await app.api.blob(`/v1/stats/${section.name}`, { ...queryOf(section, chosen), format: "csv" }));
    } catch (error) {
      toastError(error);
    }
  };
  return h("button", { type: "button", class: "small", "aria-label": `${section.heading} as CSV`, onclick: get }, icon("download"), "CSV");
}
