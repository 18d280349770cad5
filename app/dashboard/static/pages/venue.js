// One venue: where it is, and its levels from the top down.

import {
  ago, confirm, dateTime, dialog, empty, facts, form, h, icon, metres, table, toast, toastError,
} from "../ui.js";
import { anchorFields, anchorOf, placeOf } from "./venues.js";

export const title = "Venue";

export async function render(root, params, app) {
  const [venue, levels] = await Promise.all([
    app.api.get(`/v1/venues/${params.venue_id}`),
    app.api.all("/v1/levels", { venue_id: params.venue_id }),
  ]);
  app.setTitle(venue.name);
  const may = app.account.may("survey");
  root.append(
    h(
      "div",
      { class: "page-head" },
      h("p", { class: "crumbs" }, h("a", { href: "#/venues" }, "Venues")),
      h("h1", {}, venue.name),
      may && h(
        "div",
        { class: "row" },
        h("button", { type: "button", onclick: () => edit(app, venue) }, icon("edit"), "Edit"),
        levels.length === 0 && h("button", { type: "button", class: "danger", onclick: () => remove(app, venue) }, icon("trash"), "Delete"),
        h("button", { type: "button", class: "primary", onclick: () => createLevel(app, venue, levels) }, icon("plus"), "New level"),
      ),
    ),
    h("section", { class: "card", "aria-label": "About the venue" }, about(venue)),
    h("section", { class: "card", "aria-label": "Levels" }, h("h2", {}, "Levels"), levels.length ? levelTable(levels) : noLevels(may)),
  );
}

function about(venue) {
  const anchor = venue.anchor;
  return facts([
    ["Kind", venue.kind],
    ["Origin of the plan", anchor ? placeOf(anchor) : "no anchor: positions in plan metres only"],
    ["Bearing of the y axis", anchor && `${anchor.bearing_deg}° from north`],
    ["Created", dateTime(venue.created_at)],
    ["Id", h("code", {}, venue.id)],
  ]);
}

function levelTable(levels) {
  const plans = (level) => [level.has_plan_image && "picture", level.has_vector_plan && "vector"].filter(Boolean).join(", ");
  return table(
    [
      { head: "Name", cell: (level) => h("a", { href: `#/levels/${level.id}` }, level.name) },
      { head: "Storey", number: true, cell: (level) => level.ordinal },
      { head: "Size", cell: ({ extent }) => `${metres(extent.x_max - extent.x_min)} × ${metres(extent.y_max - extent.y_min)}` },
      { head: "Plan", cell: (level) => plans(level) || h("span", { class: "soft" }, "none") },
      { head: "Map", cell: (level) => (level.current_map_id ? h("span", { class: "badge good" }, "mapped") : h("span", { class: "badge" }, "no map")) },
      { head: "Changed", cell: (level) => h("time", { datetime: level.updated_at }, ago(level.updated_at)) },
    ],
    [...levels].sort((a, b) => b.ordinal - a.ordinal),
    { caption: "Levels, highest first" },
  );
}

function noLevels(may) {
  return empty("No levels yet", may ? "A level is one storey; an outdoor venue has one." : null);
}

async function edit(app, venue) {
  const changed = await dialog("Edit the venue", (close) => form(
    [{ name: "name", label: "Name", required: true, maxlength: 200, value: venue.name }, ...anchorFields(venue.anchor)],
    async (values) => close(await app.api.patch(`/v1/venues/${venue.id}`, { name: values.name, anchor: anchorOf(values.anchor) })),
    { cancel: () => close(null) },
  ));
  if (changed) app.reload();
}

async function remove(app, venue) {
  if (!(await confirm("Delete the venue", `“${venue.name}” has no levels. It will be gone for good.`, { action: "Delete", danger: true }))) return;
  try {
    await app.api.delete(`/v1/venues/${venue.id}`);
    toast(`${venue.name} was deleted.`);
    app.go("/venues");
  } catch (error) {
    toastError(error);
  }
}

async function createLevel(app, venue, levels) {
  const next = levels.length ? Math.max(...levels.map((level) => level.ordinal)) + 1 : 0;
  const made = await dialog("New level", (close) => form(
    [
      { name: "name", label: "Name", required: true, maxlength: 200, placeholder: "F2" },
      { name: "ordinal", label: "Storey (0 is the ground floor)", type: "number", step: 1, required: true, value: next },
      { name: "width", label: "Width of the plan, m (x)", type: "number", min: 1, max: 20000, required: true, half: true },
      { name: "height", label: "Height of the plan, m (y)", type: "number", min: 1, max: 20000, half: true, hint: "Empty: as the picture’s proportions say." },
      { name: "picture", label: "Plan picture (PNG)", type: "file", accept: "image/png", hint: "It covers the level from edge to edge, north or y up. It can be placed by two known points later." },
    ],
    async (values) => close(await makeLevel(app, venue, values)),
    { submit: "Create", cancel: () => close(null) },
  ));
  if (made) app.go(`/levels/${made.id}`);
}

async function makeLevel(app, venue, { name, ordinal, width, height, picture }) {
  const image = picture && await createImageBitmap(picture);
  const extent = { x_min: 0, y_min: 0, x_max: width, y_max: height ?? (image ? (width * image.height) / image.width : width) };
  const level = await app.api.post(`/v1/venues/${venue.id}/levels`, { name, ordinal, extent });
  if (picture) await app.api.fetch("PUT", `/v1/levels/${level.id}/plan.png`, { body: picture, headers: { "Content-Type": "image/png" } });
  return level;
}
