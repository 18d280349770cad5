// What else is known about a session: its place, its device, known positions, events, contributions, files.

import { hrefOf } from "../routes.js";
import {
  ago, dateTime, download, facts, fill, fixed, h, metres, percent, select, table, timeOfDay, toastError,
} from "../ui.js";

const TRACKS = [["geojson", "GeoJSON", ".geojson"], ["mf-json", "MF-JSON", ".mf.json"], ["gpx", "GPX", ".gpx"], ["csv", "CSV", ".csv"]];
const KINDS = [["filtered", "as told then"], ["fixed_lag", "told 5 s later"], ["smoothed", "smoothed"]];
const RAW = [["csv", "CSV"], ["msgpack", "MessagePack"]];
const EVENTS = { enter: "enters", leave: "leaves", dwell: "dwells" };
const SIDES = ["Forward", "Left", "Up"];

/** What was said when the session was opened. */
export function aboutCard(session, { venue, device }) {
  const { prior } = session;
  return card("About the session", facts([
    ["Venue", h("a", { href: `#/venues/${venue.id}` }, venue.name)],
    ["Device", device ? link(`/devices/${device.id}`, device.name) : "none named"],
    ["Method", session.method],
    ["Known at the start", prior.x === null ? "the place only" : `within ${metres(prior.radius_m)} of ${placeText(prior)}`],
    ["Opened", dateTime(session.created_at)],
    ["Closed", session.closed_at && dateTime(session.closed_at)],
    ["Offers to the map", session.contributes ? "yes" : "no"],
    ["Id", h("code", {}, session.id)],
  ]));
}

/** What the device added to the field: as known at the start, and as the session found out. */
export function calibrationCard(session, profile) {
  const learned = profile?.learned ? profile.calibration : null;
  const rows = [["At the start", session.calibration], ["Learned by now", learned]].filter(([, one]) => one);
  const body = rows.length === 0
    ? h("p", { class: "soft" }, "Nothing is known yet: it takes some metres, and a turn.")
    : rows.map(([name, one]) => h("div", {}, h("h3", {}, name), calibrationFacts(one)));
  return card("Device calibration", body);
}

/** Offsets of a levelled device and its carrier's stride, with their standard deviations. */
export function calibrationFacts(one) {
  const largest = Math.max(...one.soft_iron.map(Math.abs));
  return facts([
    ...SIDES.map((side, i) => [`${side}, µT`, withSpread(one.offset[i], one.offset_sd[i])]),
    ["Stride, factor", withSpread(one.stride_scale, one.stride_scale_sd, 2)],
    ["Soft iron, at most", percent(largest, 1)],
  ]);
}

function placeText({ x, y }) {
  return `x ${fixed(x)} m, y ${fixed(y)} m`;
}

function withSpread(value, spread, decimals = 1) {
  return `${fixed(value, decimals)} ± ${fixed(spread, decimals)}`;
}

/** Known positions with what was told there. */
export function truthCard(points) {
  const settled = points.filter((one) => one.fix);
  const errors = settled.map((one) => one.fix.error_m).sort((a, b) => a - b);
  const inside = settled.filter((one) => one.fix.inside).length / settled.length;
  return card(
    "Known positions",
    errors.length > 0 && h("p", { class: "soft" }, `Median error ${metres(errors[Math.floor(errors.length / 2)])}; ${percent(inside)} inside the 95\u202f% ellipse.`),
    table(
      [
        { head: "Time", cell: (one) => timeOfDay(one.t_ms) },
        { head: "x, y, m", cell: (one) => `${fixed(one.x)}, ${fixed(one.y)}` },
        { head: "Error", number: true, cell: (one) => (one.fix ? metres(one.fix.error_m) : "–") },
        { head: "In the ellipse", cell: (one) => (one.fix ? h("span", { class: `badge ${one.fix.inside ? "good" : "bad"}` }, one.fix.inside ? "yes" : "no") : h("span", { class: "soft" }, one.settled ? "no fix near" : "waiting")) },
      ],
      points,
      { caption: "Known positions" },
    ),
  );
}

/** Geofences that it entered and left. */
export function eventsCard(events) {
  return card("Geofences", table(
    [
      { head: "Time", cell: (one) => timeOfDay(one.t_ms) },
      { head: "Event", cell: (one) => EVENTS[one.kind] ?? one.kind },
      { head: "Geofence", cell: (one) => one.geofence_name },
      { head: "Probability", number: true, cell: (one) => percent(one.probability) },
    ],
    events,
    { caption: "Events of geofences" },
  ));
}

/** What it offered to maps. */
export function contributionsCard(session, items) {
  const words = (one) => [h("span", { class: "badge" }, one.state), ` ${one.verdict || `${one.n_kept} of ${one.n_steps} steps offered`} `, h("span", { class: "soft" }, ago(one.created_at))];
  return card(
    "Contribution",
    items.length ? h("ul", { class: "stack" }, items.map((one) => h("li", {}, words(one)))) : h("p", { class: "soft" }, session.status === "open" ? "Made when the session is closed." : "None was made of it."),
    items.length > 0 && h("p", {}, h("a", { href: `#/contributions?session_id=${session.id}` }, "Review")),
  );
}

/** Several places that fit, with their weights; `update(hypotheses)`. */
export function hypothesesList(levelName) {
  const rows = h("ul", { class: "hypotheses" });
  const element = h("div", { hidden: true }, h("h3", {}, "Places that fit"), rows);
  return {
    element,
    update(hypotheses) {
      element.hidden = hypotheses.length === 0;
      rows.replaceChildren(...hypotheses.map((one) => h(
        "li",
        {},
        h("b", {}, percent(one.weight)),
        h("progress", { max: 1, value: one.weight, "aria-hidden": "true" }),
        h("span", {}, `${levelName(one.level_id)}, ${placeText(one)}`),
      )));
    },
  };
}

/** Files to take home. */
export function downloadsCard(app, session, anchored) {
  let kind = "filtered";
  const save = async (button, path, query, name) => {
    button.disabled = true;
    try {
      download(name, await app.api.blob(path, query));
    } catch (error) {
      toastError(error);
    } finally {
      button.disabled = false;
    }
  };
  const button = (words, path, query, name) => {
    const made = h("button", { type: "button", class: "small", onclick: () => save(made, path, query(), name()) }, words);
    return made;
  };
  const path = `/v1/sessions/${session.id}`;
  const tracks = TRACKS.map(([format, words, suffix]) => {
    const made = button(words, `${path}/track`, () => ({ format, kind }), () => `${session.id}${kind === "filtered" ? "" : `-${kind}`}${suffix}`);
    // without an anchor nobody knows where on Earth the plan lies
    if (!anchored && format !== "csv") made.disabled = true;
    return made;
  });
  const why = !anchored && h("p", { class: "soft small" }, "The others need the venue’s place on Earth: ", h("a", { href: `#/venues/${session.venue_id}` }, "give its latitude and longitude"), ".");
  const raw = RAW.map(([format, words]) => button(words, `${path}/samples`, () => ({ format }), () => `${session.id}-samples.${format}`));
  return card(
    "Files",
    select("Track", KINDS, kind, (value) => { kind = value; }),
    h("div", { class: "row start" }, tracks),
    why,
    h("p", { class: "labelled" }, h("b", { class: "small" }, "Raw samples")),
    h("div", { class: "row start" }, raw),
  );
}

const listed = new WeakMap();

/** Fill a place with a card of a list, or leave it empty where there is nothing to show; the same list is left as it stands. */
export async function listCard(place, read, draw) {
  try {
    const items = await read();
    const text = JSON.stringify(items);
    if (listed.get(place) === text) return;
    await fill(place, () => (items.length ? draw(items) : h("div", { hidden: true })));
    listed.set(place, text);
  } catch (error) {
    await fill(place, () => { throw error; });
  }
}

function card(name, ...children) {
  return h("section", { class: "card", "aria-label": name }, h("h2", {}, name), children);
}

function link(path, words) {
  const href = hrefOf(path);
  return href ? h("a", { href }, words) : words;
}

