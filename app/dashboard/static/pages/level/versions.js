// Versions of the level's map: the list, publishing and rolling back, who published what.

import { ago, dateTime, dialog, form, h, percent, shortId, toast } from "../../ui.js";

const KINDS = { build: "built anew", update: "updated", import: "imported" };

/**
 * The card of versions.
 *
 * @param {object} options  level, maps (newest first), viewed (id), onview(map), oncompare(map), onpublished(),
 *     onmore() if there are older ones
 */
export function versionsCard(app, { level, maps, viewed, onview, oncompare, onpublished, onmore }) {
  const may = app.account.may("survey");
  const newest = maps.find((map) => map.id === level.current_map_id);
  const buttons = (map) => h(
    "div",
    { class: "row start tight" },
    h("button", { type: "button", class: "small", "aria-pressed": String(map.id === viewed), onclick: () => onview(map), "aria-label": `View version ${map.version}` }, "View"),
    maps.length > 1 && h("button", { type: "button", class: "small", onclick: () => oncompare(map), "aria-label": `Compare version ${map.version}` }, "Compare"),
    may && map.id !== level.current_map_id && h(
      "button",
      { type: "button", class: "small", onclick: () => publish(app, level, map, newest, onpublished) },
      newest && map.version < newest.version ? `Roll back to ${map.version}` : `Publish ${map.version}`,
    ),
  );
  return h(
    "section",
    { class: "card", "aria-labelledby": "versions" },
    h("h2", { id: "versions" }, "Versions"),
    h("ul", { class: "versions" }, maps.map((map) => h("li", { class: map.id === viewed && "viewed" }, words(map, level), buttons(map)))),
    onmore && h("button", { type: "button", class: "small", onclick: onmore }, "Show older versions"),
    may && publications(app, level, maps),
  );
}

function words(map, level) {
  const made = h("time", { datetime: map.created_at, title: dateTime(map.created_at) }, ago(map.created_at));
  return h(
    "p",
    {},
    h("b", {}, `Version ${map.version}`),
    " ",
    map.id === level.current_map_id && h("span", { class: "badge good" }, "current"),
    h("span", { class: "soft small" }, `${KINDS[map.kind] ?? map.kind} `, made, ` · ${map.n_walks} walks · ${percent(map.mapped_share)} of the level`),
  );
}

async function publish(app, level, map, current, onpublished) {
  const back = current && map.version < current.version;
  const done = await dialog(back ? `Roll back to version ${map.version}` : `Publish version ${map.version}`, (close) => [
    h("p", {}, `New sessions on ${level.name} will use version ${map.version}`, current && ` instead of ${current.version}`, ". Sessions that are open stay on theirs. Every version is kept, so this can be undone."),
    form(
      [{ name: "note", label: "Why, for the log", maxlength: 500 }],
      async ({ note }) => close(await app.api.put(`/v1/levels/${level.id}/map`, { map_id: map.id, note: note ?? "" })),
      { submit: back ? "Roll back" : "Publish", cancel: () => close(null) },
    ),
  ]);
  if (!done) return;
  toast(`Version ${map.version} is current now.`, { kind: "good" });
  onpublished();
}

function publications(app, level, maps) {
  const versionOf = (id) => maps.find((map) => map.id === id)?.version ?? shortId(id);
  const list = h("ul", { class: "log" });
  const box = h("details", {}, h("summary", {}, "What was published when"), list);
  box.addEventListener("toggle", async () => {
    if (!box.open || list.childElementCount) return;
    const { items } = await app.api.get(`/v1/levels/${level.id}/publications`, { limit: 20 });
    list.append(...items.map((one) => h(
      "li",
      {},
      h("time", { datetime: one.created_at }, dateTime(one.created_at)),
      ` version ${versionOf(one.map_id)}`,
      one.from_map_id && ` in place of ${versionOf(one.from_map_id)}`,
      one.note && h("span", { class: "soft" }, ` – ${one.note}`),
    )));
  });
  return box;
}
