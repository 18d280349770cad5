// Levels by id, with the names that people know them by.

import { h } from "../ui.js";

/** Map of level id to {level, name}: "Mall · F2". */
export async function levelNames(app) {
  const [venues, levels] = await Promise.all([app.api.all("/v1/venues"), app.api.all("/v1/levels")]);
  const places = new Map(venues.map((venue) => [venue.id, venue.name]));
  const named = levels.map((level) => [level.id, { level, name: `${places.get(level.venue_id) ?? "?"} · ${level.name}` }]);
  return new Map(named.sort(([, a], [, b]) => a.name.localeCompare(b.name)));
}

/** Choices of a select: every level, after one for all of them. */
export function levelOptions(names, all = null) {
  const options = [...names].map(([id, { name }]) => [id, name]);
  return all === null ? options : [["", all], ...options];
}

/** What stands where a level is needed and none is there. */
export function noLevels() {
  return h("p", {}, "It needs a level, and there is none: ", h("a", { href: "#/venues" }, "make a venue and a level first"), ".");
}
