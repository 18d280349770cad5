// Alarms as a list: what, where, since when, and what to do.

import { ago, h } from "../ui.js";

const BADGES = { critical: "bad", warning: "warn", info: "" };
const PAGES = { lvl: "/levels/", ses: "/sessions/", dev: "/devices/" };

/** @param {object[]} alarms  as of `GET /v1/stats/alarms`
 *  @param {(path: string) => string | null} href  address of a page, null if there is none */
export function alarmList(alarms, href) {
  if (!alarms.length) return h("p", { class: "soft" }, "Nothing needs attention.");
  return h("ul", { class: "alarms" }, alarms.map((alarm) => h(
    "li",
    {},
    h("div", { class: "row start" }, h("span", { class: `badge ${BADGES[alarm.severity]}` }, alarm.severity), h("b", {}, alarm.rule), subject(alarm.subject, href)),
    h("p", {}, linked(alarm.message, href), alarm.since && h("span", { class: "soft" }, ` · since ${ago(alarm.since)}`)),
    h("p", { class: "soft small" }, alarm.remedy),
  )));
}

// Ids in a text lead to their pages.
function linked(text, href) {
  return text.split(/((?:lvl|ses|dev)_[0-9a-f]+)/).map((part, i) => (i % 2 ? subject(part, href) : part));
}

function subject(name, href) {
  const page = PAGES[name.slice(0, 3)];
  const address = page && /^[a-z]{3}_[0-9a-f]+$/.test(name) ? href(page + name) : null;
  return address ? h("a", { href: address }, name) : h("span", { class: "soft" }, name);
}
