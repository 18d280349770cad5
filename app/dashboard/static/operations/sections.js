// The tables of the operations page: what each asks for, and how it is shown.

import { alarmList } from "../overview/alarms.js";
import { hrefOf } from "../routes.js";
import { ago, bytes, dateTime, empty, fixed, h, metres, number, percent, shortId, table } from "../ui.js";
import { latencyCharts, throughputChart } from "./graphs.js";
import { kindName } from "./words.js";

const PARTS = {
  segments: "Segments (samples)", walks: "Survey walks", map_tiles: "Map tiles", evidence: "Evidence of maps", tracker_states: "Tracker states",
  plans: "Plans", fixes: "Fixes", fixed_lag_fixes: "Fixed-lag fixes", segment_rows: "Segments (rows)", jobs: "Jobs", database_file: "Database file", map_cache: "Cached maps", disk_free: "Free on the disk", disk_total: "Disk",
};
const WINDOW = ["since", "bucket", "venue_id", "level_id", "device_id", "method"];
const seconds = (value) => (value === null ? "–" : `${fixed(value)} s`);
const count = (head, get) => ({ head, number: true, cell: (row) => number(get(row), 12) });
const words = (text) => h("p", { class: "soft" }, text);

/**
 * Sections in order: path under /v1/stats, heading, the filters it takes, whether it tells apart by something, and
 * `show(answer, context)`, which gives nodes; context: {by: {head, name(row)}, keep(chart)}.
 */
export const SECTIONS = [
  { name: "alarms", heading: "Alarms", takes: [], show: ({ items }) => alarmList(items, hrefOf) },
  { name: "latency", heading: "Latency", takes: WINDOW, show: latencyCharts },
  { name: "throughput", heading: "Throughput", takes: WINDOW, show: throughputChart },
  { name: "backlog", heading: "Backlog", takes: [], show: backlog },
  { name: "errors", heading: "Errors", takes: WINDOW, show: errors },
  { name: "fixes", heading: "Fixes by what they claim", takes: WINDOW.filter((one) => one !== "bucket"), told: true, show: fixes },
  { name: "accuracy", heading: "Error budget", takes: WINDOW.filter((one) => one !== "bucket"), told: true, show: accuracy },
  { name: "levels", heading: "Levels", takes: ["since", "venue_id", "level_id"], show: levels },
  { name: "storage", heading: "Storage", takes: [], show: storage },
];

function backlog({ items }) {
  return table(
    [
      { head: "Jobs", cell: (row) => kindName(row.kind) },
      count("Waiting", (row) => row.queued),
      count("Running", (row) => row.running),
      { head: "Oldest waits", number: true, cell: (row) => seconds(row.oldest_queued_s) },
      { head: "Oldest runs", number: true, cell: (row) => seconds(row.oldest_running_s) },
    ],
    items,
    { caption: "Backlog" },
  );
}

function errors({ items }) {
  if (!items.length) return words("Nothing failed.");
  return table(
    [
      { head: "Error", cell: (row) => h("code", {}, row.text) },
      { head: "Jobs", cell: (row) => kindName(row.kind) },
      count("Times", (row) => row.n),
      { head: "Of all", number: true, cell: (row) => percent(row.share, 1) },
      { head: "Last", cell: (row) => h("time", { datetime: row.last_at, title: dateTime(row.last_at) }, ago(row.last_at)) },
      { head: "Newest example", cell: example },
    ],
    items,
    { caption: "Errors" },
  );
}

function example(row) {
  const path = row.example_subject_id.startsWith("ses_") ? `/sessions/${row.example_subject_id}` : `/levels/${row.example_subject_id}`;
  const address = hrefOf(path);
  const subject = address ? h("a", { href: address }, shortId(row.example_subject_id)) : shortId(row.example_subject_id);
  return h(
    "details",
    {},
    h("summary", {}, subject, row.example_seq === null ? "" : `, segment ${row.example_seq}`),
    h("div", { class: "example" }, h("code", {}, row.example_error), h("span", { class: "soft small" }, row.example_job_id)),
  );
}

function fixes({ items }, context) {
  if (!items.length) return words("No fixes.");
  const share = (head, name) => ({ head, number: true, cell: (row) => percent(row[name] / row.n) });
  return table(
    [
      { head: context.by.head, cell: (row) => context.by.name(row) },
      count("Fixes", (row) => row.n),
      { head: "Sure", number: true, cell: (row) => percent(row.sure_share) },
      share("ok", "ok"),
      share("ambiguous", "ambiguous"),
      share("insufficient", "insufficient"),
      share("off map", "off_map"),
      share("disturbed", "disturbed"),
    ],
    items,
    { caption: "Fixes by what they claim" },
  );
}

function accuracy({ items }, context) {
  if (!items.length) return empty("No known positions", "Send the places that devices passed at known times, and see how well the ellipses hold.", h("a", { href: "/docs" }, "POST /v1/sessions/{session_id}/ground-truth"));
  return table(
    [
      { head: context.by.head, cell: (row) => context.by.name(row) },
      { head: "Fixes", cell: (row) => row.fixes },
      count("Places", (row) => row.n),
      { head: "p50", number: true, cell: (row) => metres(row.p50_m) },
      { head: "p90", number: true, cell: (row) => metres(row.p90_m) },
      { head: "p95", number: true, cell: (row) => metres(row.p95_m) },
      { head: "In 95 % ellipse", number: true, cell: inside },
    ],
    items,
    { caption: "Error budget" },
  );
}

function inside(row) {
  const interval = `${fixed(100 * row.inside_low, 0)} to ${fixed(100 * row.inside_high, 0)} %`;
  const kind = row.inside_high < 0.93 ? "bad" : row.inside_low > 0.93 ? "good" : "";
  return h("span", { title: `95 % interval: ${interval}` }, h("span", { class: `badge ${kind}` }, percent(row.inside_share)), h("span", { class: "soft small" }, ` ${interval}`));
}

function levels({ items }, context) {
  if (!items.length) return words("No levels.");
  return table(
    [
      { head: "Level", cell: (row) => h("a", { href: `#/levels/${row.level_id}` }, context.level(row.level_id) ?? row.name) },
      count("Sessions", (row) => row.sessions),
      { head: "Last walk", cell: (row) => ago(row.last_walk_at) },
      { head: "Map", cell: (row) => (row.map_id === null ? h("span", { class: "badge warn" }, "none") : `version ${row.map_version}`) },
      { head: "Map made", cell: (row) => ago(row.map_created_at) },
      { head: "", cell: (row) => row.map_behind && h("span", { class: "badge warn" }, "a walk is newer") },
    ],
    items,
    { caption: "Levels" },
  );
}

function storage({ items }) {
  return table(
    [
      { head: "What", cell: (row) => PARTS[row.part] ?? row.part },
      { head: "Rows", number: true, cell: (row) => number(row.rows, 12) },
      { head: "Size", number: true, cell: (row) => `${row.estimated ? "about " : ""}${bytes(row.bytes)}` },
    ],
    items,
    { caption: "Storage" },
  );
}
