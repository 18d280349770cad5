// The list of live sessions: rows that stay, and cells that are only touched when their text changes.

import { ago, fixed, h, replace, shortId } from "../ui.js";
import { statusColour, STATUS_WORDS } from "./marks.js";

const MOST_ROWS = 100;
const HEADS = ["Session", "Device", "Level", "x, y, m", "Status", "As of"];
const BADGES = { accent: "good", warn: "warn", bad: "bad", fourth: "warn", soft: "" };

/**
 * @param {object} names  level(id), device(id): what to call them
 * @param {(id: string) => string | null} href  where a session's page is, if there is one
 * @returns {{element, update(sessions)}}
 */
export function liveList(names, href) {
  const body = h("tbody", {});
  let most = MOST_ROWS;
  let told = [];
  const rest = h("span", {});
  const all = h("button", { type: "button", class: "link", onclick: () => { most = Infinity; update(told); element.querySelector(".live-list").focus(); } }, "Show all");
  const more = h("p", { class: "soft small", hidden: true }, rest, " ", all);
  const rows = new Map();
  const element = h(
    "div",
    { class: "stack" },
    h(
      "div",
      { class: "scroll live-list", tabindex: "0", role: "region", "aria-label": "Live sessions" },
      h(
        "table",
        {},
        h("caption", { class: "visually-hidden" }, "Live sessions"),
        h("thead", {}, h("tr", {}, HEADS.map((head) => h("th", { scope: "col" }, head)))),
        body,
      ),
    ),
    more,
  );
  const update = (sessions) => {
    told = sessions;
    const shown = sessions.slice(0, most);
    const wanted = new Set(shown.map((one) => one.session_id));
    for (const [id, row] of rows) if (!wanted.has(id)) { row.element.remove(); rows.delete(id); }
    shown.forEach((one, i) => {
      let row = rows.get(one.session_id);
      if (!row) rows.set(one.session_id, (row = makeRow(one, href(one.session_id))));
      if (body.children[i] !== row.element) body.insertBefore(row.element, body.children[i] ?? null);
      row.update(one, names);
    });
    more.hidden = sessions.length <= most;
    if (!more.hidden) write(rest, `and ${sessions.length - most} more`);
  };
  return { element, update };
}

function makeRow({ session_id: id }, href) {
  const cells = HEADS.map(() => h("td", {}));
  const badge = h("span", { class: "badge" });
  replace(cells[0], href ? h("a", { href, title: id }, shortId(id)) : h("span", { title: id }, shortId(id)));
  cells[4].append(badge);
  return {
    element: h("tr", {}, cells),
    update(one, names) {
      const known = one.x !== null;
      for (const [cell, name] of [[cells[1], names.device(one.device_id)], [cells[2], names.level(one.level_id)]]) {
        write(cell, name);
        if (cell.title !== name) cell.title = name;
      }
      write(cells[3], known ? `${fixed(one.x)}, ${fixed(one.y)}` : "–");
      write(badge, known ? `${one.status.replace("_", " ")}${one.sure ? ", sure" : ""}` : "no position yet");
      const kind = known ? BADGES[statusColour(one.status)] : "";
      if (badge.dataset.kind !== kind) {
        badge.dataset.kind = kind;
        badge.className = `badge ${kind}`;
        badge.title = known ? STATUS_WORDS[one.status] : "";
      }
      write(cells[5], known ? ago(one.t_ms, "short") : "–");
    },
  };
}

function write(element, text) {
  if (element.firstChild?.nodeValue !== text) element.textContent = text;
}
