// Geofences: areas on levels, drawn on the plan, and what sessions did at them.

import { haloText } from "../canvas.js";
import { colour } from "../theming.js";
import { levelPlan } from "../plans.js";
import {
  confirm, dialog, download, duration, empty, form, h, icon, moment, pager, percent, select, shortId, table, toast, toastError,
} from "../ui.js";
import { levelNames, levelOptions, noLevels } from "./level_names.js";

export const title = "Geofences";

const EVENTS = [["enter", "enters"], ["leave", "leaves"], ["dwell", "dwells"]];

export async function render(root, params, app) {
  const names = await levelNames(app);
  let levelId = names.has(app.query.get("level_id")) ? app.query.get("level_id") : "";
  const [list, past] = [h("div", {}), h("div", {})];
  const may = app.account.may("survey");
  const draw = () => {
    list.replaceChildren(pager({
      pages: app.api.pages("/v1/geofences", { limit: 50, level_id: levelId }),
      render: (items) => fenceTable(app, items, names, may, draw),
      empty: empty("No geofences", "An area of a level: sessions that enter, leave or dwell in it are told, also to webhooks.", names.size === 0 && noLevels()),
    }));
    if (app.account.may("locate")) past.replaceChildren(eventPager(app, levelId));
  };
  const add = async () => { if (await create(app, names, levelId)) draw(); };
  root.append(
    h(
      "div",
      { class: "page-head" },
      h("h1", {}, "Geofences"),
      h(
        "div",
        { class: "row" },
        select("Level", levelOptions(names, "All levels"), levelId, (id) => { levelId = id; app.setQuery({ level_id: id }); draw(); }),
        may && h("button", { type: "button", class: "primary", disabled: names.size === 0, onclick: add }, icon("plus"), "New geofence"),
      ),
    ),
    h("section", { class: "card", "aria-label": "Geofences" }, list),
    app.account.may("locate") && h(
      "section",
      { class: "card", "aria-label": "Events" },
      h("header", {}, h("h2", {}, "Events"), h("button", { type: "button", class: "small", onclick: () => save(app, levelId) }, icon("download"), "CSV")),
      past,
    ),
  );
  draw();
}

function fenceTable(app, items, names, may, draw) {
  const remove = async (fence) => {
    if (!(await confirm(`Delete ${fence.name}?`, "Nothing is told of it any more; what was told stays.", { action: "Delete", danger: true }))) return;
    try {
      await app.api.delete(`/v1/geofences/${fence.id}`);
      toast(`${fence.name} is deleted.`);
      draw();
    } catch (error) {
      toastError(error);
    }
  };
  return table(
    [
      { head: "Name", cell: (fence) => h("b", {}, fence.name) },
      { head: "Level", cell: (fence) => h("a", { href: `#/levels/${fence.level_id}` }, names.get(fence.level_id)?.name ?? fence.level_id) },
      { head: "Tells who", cell: (fence) => fence.events.map((one) => new Map(EVENTS).get(one)).join(", ") + (fence.dwell_s ? ` (${duration(fence.dwell_s)})` : "") },
      { head: "When at least as sure as", number: true, cell: (fence) => percent(fence.confidence) },
      { head: "", cell: (fence) => may && h("span", { class: "cell-actions" }, h("button", { type: "button", class: "small danger", "aria-label": `Delete ${fence.name}`, onclick: () => remove(fence) }, "Delete")) },
    ],
    items,
    { caption: "Geofences" },
  );
}

function eventPager(app, levelId) {
  return pager({
    pages: app.api.pages("/v1/geofence-events", { limit: 50, level_id: levelId }),
    render: (items) => table(
      [
        { head: "Time", cell: (one) => moment(one.t_ms) },
        { head: "Session", cell: (one) => h("a", { href: `#/sessions/${one.session_id}`, title: one.session_id }, shortId(one.session_id)) },
        { head: "Event", cell: (one) => new Map(EVENTS).get(one.kind) },
        { head: "Geofence", cell: (one) => one.geofence_name },
        { head: "Probability", number: true, cell: (one) => percent(one.probability) },
        { head: "Stayed", number: true, cell: (one) => (one.dwell_s === null ? "–" : duration(one.dwell_s)) },
      ],
      items,
      { caption: "Events of geofences" },
    ),
    empty: empty("No events yet", "They come with the fixes of sessions on levels that have geofences."),
  });
}

async function save(app, levelId) {
  try {
    download("geofence-events.csv", await app.api.blob("/v1/geofence-events", { format: "csv", level_id: levelId }));
  } catch (error) {
    toastError(error);
  }
}

/** Ask for the level, then for the area; true if one was made. */
async function create(app, names, levelId) {
  const id = levelId || await dialog("On which level?", (close) => form(
    [{ name: "level_id", label: "Level", type: "select", options: levelOptions(names) }],
    async (values) => close(values.level_id),
    { submit: "Go on", cancel: () => close(null) },
  ));
  if (!id) return false;
  const level = await app.api.get(`/v1/levels/${id}`);
  const view = await levelPlan(app, level);
  const made = await dialog(`New geofence on ${level.name}`, (close) => drawing(app, level, view, close), { wide: true });
  view.destroy();
  if (made) toast(`${made.name} was created.`, { kind: "good" });
  return Boolean(made);
}

function drawing(app, level, view, close) {
  const ring = [];
  view.add(ringLayer(ring));
  view.onpick = ({ x, y }) => { ring.push([Number(x.toFixed(2)), Number(y.toFixed(2))]); view.redraw(); };
  const anew = h("button", { type: "button", class: "small", onclick: () => { ring.length = 0; view.redraw(); } }, "Draw anew");
  return [
    h("p", { class: "soft" }, "Click the corners of the area, one after the other (or Enter at the crosshair)."),
    view.element,
    anew,
    form(
      [
        { name: "name", label: "Name", required: true, maxlength: 200, autocomplete: "off" },
        ...EVENTS.map(([name, words]) => ({ name: `on.${name}`, label: `Tell who ${words}`, type: "checkbox", value: name !== "dwell" })),
        { name: "dwell_s", label: "Dwelling begins after, s", type: "number", min: 1, max: 86400, value: 60, half: true },
        { name: "confidence", label: "Told when as sure as (0.5 to 1)", type: "number", min: 0.5, max: 0.999, value: 0.9, half: true },
      ],
      async ({ name, on, dwell_s, confidence }) => {
        const events = EVENTS.map(([one]) => one).filter((one) => on[one]);
        const more = on.dwell ? { dwell_s } : {};
        close(await app.api.post("/v1/geofences", { name, level_id: level.id, polygon: ring, events, confidence, ...more }));
      },
      { submit: "Create", cancel: () => close(null) },
    ),
  ];
}

function ringLayer(ring) {
  return {
    visible: true,
    draw(context, view) {
      if (!ring.length) return;
      context.strokeStyle = colour("fifth");
      context.fillStyle = colour("fifth");
      context.lineWidth = 2;
      context.beginPath();
      for (const point of ring) context.lineTo(...view.pixel(...point));
      context.closePath();
      context.globalAlpha = 0.15;
      context.fill();
      context.globalAlpha = 1;
      context.stroke();
      ring.forEach((point, i) => {
        const [x, y] = view.pixel(...point);
        haloText(context, String(i + 1), x + 5, y - 5, colour("fifth"));
      });
    },
  };
}
