// Venues: the list, search, and making one.

import { ago, dialog, empty, form, h, icon, pager, table, toast } from "../ui.js";

export const title = "Venues";

const KINDS = [["indoor", "Indoor: a building"], ["route", "Route: a road or corridor"], ["area", "Area: open ground"]];

export async function render(root, params, app) {
  const list = h("div", {});
  let words = app.query.get("q") ?? "";
  const draw = () => list.replaceChildren(pager({
    pages: app.api.pages("/v1/venues", { limit: 50, q: words }),
    render: venueTable,
    empty: words
      ? empty("No venue of this name", "Words or the beginnings of words are looked for, in any order.")
      : empty("No venues yet", "A venue is a place with one local frame: a building, a road corridor, a survey area.", app.account.may("survey") && createButton(app)),
  }));
  root.append(
    h(
      "div",
      { class: "page-head" },
      h("h1", {}, "Venues"),
      h("div", { class: "row" }, searchBox(words, (text) => { words = text; app.setQuery({ q: text }); draw(); }), app.account.may("survey") && createButton(app)),
    ),
    h("section", { class: "card" }, list),
  );
  draw();
}

function searchBox(value, onsearch) {
  let timer = 0;
  const input = h("input", {
    type: "search", "aria-label": "Find venues by name", placeholder: "Find by name", value,
    oninput: () => {
      clearTimeout(timer);
      timer = setTimeout(() => onsearch(input.value.trim()), 200);
    },
  });
  return h("div", { class: "search" }, icon("search"), input);
}

function venueTable(items) {
  return table(
    [
      { head: "Name", cell: (venue) => h("a", { href: `#/venues/${venue.id}` }, venue.name) },
      { head: "Kind", cell: (venue) => venue.kind },
      { head: "On earth", cell: (venue) => (venue.anchor ? placeOf(venue.anchor) : h("span", { class: "soft" }, "no anchor")) },
      { head: "Created", cell: (venue) => h("time", { datetime: venue.created_at }, ago(venue.created_at)) },
    ],
    items,
    { caption: "Venues" },
  );
}

/** Latitude and longitude as text. */
export function placeOf({ latitude_deg: latitude, longitude_deg: longitude }) {
  const text = (value, [plus, minus]) => `${Math.abs(value).toFixed(4)}° ${value < 0 ? minus : plus}`;
  return `${text(latitude, "NS")}, ${text(longitude, "EW")}`;
}

function createButton(app) {
  return h("button", { type: "button", class: "primary", onclick: () => create(app) }, icon("plus"), "New venue");
}

async function create(app) {
  const made = await dialog("New venue", (close) => form(
    [
      { name: "name", label: "Name", required: true, maxlength: 200 },
      { name: "kind", label: "Kind", type: "select", options: KINDS, value: "indoor" },
      ...anchorFields(null),
    ],
    async (values) => close(await app.api.post("/v1/venues", { ...values, anchor: anchorOf(values.anchor) })),
    { submit: "Create", cancel: () => close(null) },
  ));
  if (made) {
    toast(`${made.name} was created.`, { kind: "good" });
    app.go(`/venues/${made.id}`);
  }
}

/** Fields of an anchor; all empty: none. */
export function anchorFields(anchor) {
  return [
    { name: "anchor.latitude_deg", label: "Latitude of the plan's origin, degrees", type: "number", min: -89.9, max: 89.9, value: anchor?.latitude_deg, hint: "Leave latitude and longitude empty for a venue without a place on earth." },
    { name: "anchor.longitude_deg", label: "Longitude, degrees", type: "number", min: -180, max: 180, value: anchor?.longitude_deg },
    { name: "anchor.bearing_deg", label: "Bearing of the plan's y axis, degrees clockwise from north", type: "number", min: -360, max: 360, value: anchor?.bearing_deg ?? 0 },
  ];
}

/** The anchor of a form's values, as the API takes it. */
export function anchorOf(values) {
  if (values.latitude_deg === null && values.longitude_deg === null) return null;
  return Object.fromEntries(Object.entries(values).filter(([, value]) => value !== null));
}
