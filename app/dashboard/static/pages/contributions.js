// What everyday sessions offered to the maps: a queue with verdicts, and lasting changes of the field.

import { ago, confirm, dateTime, dialog, empty, fixed, h, icon, pager, select, table, toast, toastError, unit } from "../ui.js";
import { colour } from "../theming.js";
import { levelPlan } from "../plans.js";
import { levelNames, levelOptions } from "./level_names.js";

export const title = "Contributions";

const STATES = [
  ["", "All"], ["quarantined", "Quarantined"], ["waiting", "Waiting"], ["offered", "Offered"], ["used", "Used"], ["rejected", "Rejected"], ["empty", "Empty"],
];
const BADGES = { used: "good", waiting: "warn", offered: "accent", quarantined: "bad", rejected: "bad", empty: "" };
const MEANING = {
  offered: "not yet weighed", used: "counts in the map, in part at least", waiting: "for an independent contributor",
  quarantined: "contradicts others, or physics", rejected: "by a person", empty: "nothing was sure enough",
};
const FILTERS = ["level_id", "state", "contributor", "session_id"];

export async function render(root, params, app) {
  const names = await levelNames(app);
  const chosen = Object.fromEntries(FILTERS.map((name) => [name, app.query.get(name) ?? ""]));
  const [queue, changes, notice] = [h("div", {}), h("div", {}), h("div", { class: "row start" })];
  const draw = () => {
    const pages = queuePager(app, names, chosen, draw, only);
    queue.replaceChildren(pages);
    changes.replaceChildren(changesPager(app, names, chosen.level_id));
    notice.replaceChildren(...["contributor", "session_id"].filter((name) => chosen[name]).map((name) => tag(name, chosen[name], () => only({ [name]: "" }))));
    return pages.ready;
  };
  const only = (values) => {
    Object.assign(chosen, values);
    app.setQuery(chosen);
    draw();
  };
  root.append(
    h(
      "div",
      { class: "page-head" },
      h("div", { class: "lead-in" }, h("h1", {}, "Contributions"), h("p", {}, "Evidence for the maps from sessions that opted in, weighed by physics and by agreement.")),
      h(
        "div",
        { class: "filters" },
        select("Level", levelOptions(names, "All levels"), chosen.level_id, (id) => only({ level_id: id })),
        select("State", STATES, chosen.state, (state) => only({ state })),
      ),
    ),
    h("section", { class: "card" }, h("h2", {}, "Review"), notice, queue),
    h("section", { class: "card" }, h("h2", {}, "Lasting changes of the field"), h("p", { class: "soft" }, "Places where independent passes agree that the field is another one: a new lift, moved steel."), changes),
  );
  draw();
}

function tag(name, value, remove) {
  const words = name === "contributor" ? "Of key" : "Of session";
  return h("span", { class: "badge accent" }, `${words} ${value}`, h("button", { type: "button", class: "quiet small", "aria-label": `No longer only ${words.toLowerCase()} ${value}`, onclick: remove }, icon("close")));
}

function queuePager(app, names, chosen, redraw, only) {
  return pager({
    pages: app.api.pages("/v1/contributions", { limit: 50, ...chosen }),
    render: (items) => queueTable(app, names, items, redraw, only),
    empty: FILTERS.some((name) => chosen[name])
      ? empty("None of this kind", "Choose another level or state.")
      : empty("No contributions yet", "Sessions that are opened with “contribute” offer what they were sure of when they are closed."),
  });
}

function queueTable(app, names, items, redraw, only) {
  const columns = [
    { head: "When", cell: (one) => h("time", { datetime: one.created_at, title: dateTime(one.created_at) }, ago(one.created_at)) },
    { head: "Level", cell: (one) => names.get(one.level_id)?.name ?? one.level_id },
    { head: "State", cell: (one) => h("span", { class: `badge ${BADGES[one.state]}`, title: MEANING[one.state] }, one.state) },
    { head: "Steps kept", number: true, cell: (one) => `${one.n_kept} of ${one.n_steps}` },
    { head: "Agree", number: true, cell: (one) => one.n_agreed },
    { head: "Disagree", number: true, cell: (one) => one.n_disagreed },
    { head: "Verdict and reasons", cell: (one) => h("div", { class: "verdict" }, one.verdict || h("span", { class: "soft" }, MEANING[one.state]), one.reasons.map((reason) => h("small", {}, reason))) },
    { head: "From", cell: (one) => sourceLinks(one, only) },
    { head: "", cell: (one) => actions(app, names, one, redraw) },
  ];
  return table(columns, items, { caption: "Contributions", row: (one) => ({ dataset: { contribution: one.id } }) });
}

function sourceLinks(one, only) {
  const tail = (id) => `…${id.slice(-6)}`;
  return h(
    "div",
    { class: "verdict source" },
    h("button", { type: "button", class: "link", title: `Only of ${one.contributor}`, onclick: () => only({ contributor: one.contributor }) }, `key ${tail(one.contributor)}`),
    h("small", {}, h("a", { href: `#/sessions/${one.session_id}` }, `session ${tail(one.session_id)}`)),
  );
}

function actions(app, names, one, redraw) {
  const place = one.box && h("button", { type: "button", class: "quiet small", onclick: () => showBox(app, names, one.level_id, one.box) }, icon("pin"), "Where");
  if (!app.account.may("admin")) return place ?? "";
  const decide = one.state === "rejected"
    ? button("Restore", "check", () => act(app, one, "restore", redraw))
    : button("Reject", "close", () => act(app, one, "reject", redraw));
  return h("div", { class: "row" }, place, decide, button("Delete", "trash", () => forget(app, one, redraw), "danger"));
}

function button(words, name, onclick, kind = "") {
  return h("button", { type: "button", class: `small ${kind}`, onclick }, icon(name), words);
}

async function act(app, one, verb, redraw) {
  try {
    const now = await app.api.post(`/v1/contributions/${one.id}/${verb}`);
    toast(`The contribution is ${now.state}; the map is updated with the next job.`, { kind: "good" });
  } catch (error) {
    toastError(error);
  }
  await redraw();
  focusOn(one);
}

// The list is drawn anew under the reader's hand: back to the same line, or to the list if the line is gone.
function focusOn(one) {
  const line = document.querySelector(`[data-contribution="${one.id}"] .row button:last-child`);
  (line?.previousElementSibling ?? document.querySelector("[aria-label=Contributions]") ?? document.querySelector("main")).focus();
}

async function forget(app, one, redraw) {
  const sure = await confirm("Delete this contribution?", "It is forgotten for good, and the level’s map is updated without it. Older versions of the map stay as they are.", { action: "Delete", danger: true });
  if (!sure) return;
  try {
    await app.api.delete(`/v1/contributions/${one.id}`);
    toast("The contribution was deleted.");
  } catch (error) {
    toastError(error);
  }
  await redraw();
  focusOn(one);
}

function changesPager(app, names, levelId) {
  return pager({
    pages: app.api.pages("/v1/changes", { limit: 50, level_id: levelId }),
    render: (items) => table(
      [
        { head: "Found", cell: (one) => h("time", { datetime: one.created_at }, ago(one.created_at)) },
        { head: "Level", cell: (one) => names.get(one.level_id)?.name ?? one.level_id },
        { head: "Area", number: true, cell: (one) => unit(one.area_m2, "m²") },
        { head: "Change, µT", number: true, cell: (one) => one.delta.map((value) => fixed(value, 1)).join(", ") },
        { head: "Between", cell: (one) => `${dateTime(one.after)} and ${dateTime(one.before)}` },
        { head: "", cell: (one) => h("button", { type: "button", class: "quiet small", onclick: () => showBox(app, names, one.level_id, one.box) }, icon("pin"), "Where") },
      ],
      items,
      { caption: "Lasting changes of the field" },
    ),
    empty: empty("No lasting change is known", "A change is told when independent passes, days apart, agree on it."),
  });
}

async function showBox(app, names, levelId, box) {
  const { level, name } = names.get(levelId);
  const plan = await levelPlan(app, level);
  plan.add(boxLayer(box));
  await dialog(name, () => [h("p", { class: "soft" }, `x ${fixed(box[0])} to ${fixed(box[2])} m, y ${fixed(box[1])} to ${fixed(box[3])} m`), plan.element]);
  plan.destroy();
}

function boxLayer([x0, y0, x1, y1]) {
  return {
    visible: true,
    draw(context, view) {
      const [left, top] = view.pixel(x0, y1);
      const [right, bottom] = view.pixel(x1, y0);
      context.strokeStyle = context.fillStyle = colour("second");
      context.lineWidth = 2.5;
      context.strokeRect(left, top, right - left, bottom - top);
      context.globalAlpha = 0.15;
      context.fillRect(left, top, right - left, bottom - top);
    },
  };
}
