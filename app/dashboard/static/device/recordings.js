// What phones recorded: state, what is wrong, what became of it; waypoints for a walk that waits for them.

import { levelPlan } from "../plans.js";
import { haloText } from "../canvas.js";
import { colour } from "../theming.js";
import { ago, dateTime, dialog, duration, empty, h, number, pager, replace, shortId, table, timeOfDay, toast, toastError } from "../ui.js";

const BADGES = { open: "good", waiting: "warn", closed: "" };
const LOOK_MS = 4000;
const SHOWN = 20;

/** The card: `element`, `begin()`, `destroy()`. Looks again every few seconds while the page is open. */
export function recordingsCard(app, device) {
  const place = h("div", {});
  let timer = 0;
  let known = "";
  const look = async () => {
    try {
      const page = await app.api.get("/v1/recordings", { device_id: device.id, limit: SHOWN });
      const text = JSON.stringify(page.items);
      if (text !== known) draw(page);
      known = text;
    } catch (error) {
      if (error.name !== "AbortError") toastError(error);
    }
    timer = setTimeout(look, LOOK_MS);
  };
  const draw = (page) => {
    if (!page.items.length) return replace(place, empty("Nothing was recorded yet", "A recording appears here with its first message."));
    const first = (async function* pages() {
      yield page;
      if (page.next_cursor) yield* app.api.pages("/v1/recordings", { device_id: device.id, limit: SHOWN, cursor: page.next_cursor });
    })();
    return replace(place, pager({ pages: first, render: (items) => recordingTable(app, items, look), empty: null }));
  };
  return {
    element: h("section", { class: "card", "aria-label": "Recordings" }, h("h2", {}, "Recordings"), place),
    begin: look,
    destroy: () => clearTimeout(timer),
  };
}

function recordingTable(app, items, look) {
  return table(
    [
      { head: "Begun", cell: (one) => h("time", { datetime: one.opened_at, title: dateTime(one.opened_at) }, ago(one.opened_at, "short")) },
      { head: "State", cell: (one) => [h("span", { class: `badge ${one.problem && one.state !== "waiting" ? "bad" : BADGES[one.state]}` }, one.state), one.problem && h("p", { class: "small trouble" }, one.problem)] },
      { head: "Samples", number: true, cell: received },
      { head: "Lasted", number: true, cell: (one) => duration((new Date(one.last_at) - new Date(one.opened_at)) / 1000) },
      { head: "Became", cell: outcome },
      { head: "", cell: (one) => h("span", { class: "cell-actions" }, actions(app, one, look)) },
    ],
    items,
    { caption: "Recordings", row: (one) => ({ dataset: { recording: one.id } }) },
  );
}

// The samples of a survey walk are put together when it ends: until then its messages say that it arrives.
function received(one) {
  if (one.purpose === "survey" && one.state === "open") return `${number(one.n_messages)} ${one.n_messages === 1 ? "message" : "messages"}`;
  return number(one.n_samples);
}

function outcome(one) {
  if (one.session_id) return h("a", { href: `#/sessions/${one.session_id}` }, `session ${shortId(one.session_id)}`);
  if (one.walk_ids.length) return h("a", { href: `#/surveys/${one.survey_id}` }, `${one.walk_ids.length} ${one.walk_ids.length === 1 ? "walk" : "walks"}`);
  return h("span", { class: "soft" }, one.purpose === "survey" ? `${one.annotations.length} ${one.annotations.length === 1 ? "annotation" : "annotations"}` : "nothing yet");
}

function actions(app, one, look) {
  const end = async () => {
    try {
      await app.api.post(`/v1/recordings/${one.id}/close`);
      toast("The recording is ended.", { kind: "good" });
      app.reload();
    } catch (error) {
      toastError(error);
    }
  };
  const place = async () => { if (await placeWalk(app, one)) app.reload(); };
  return [
    one.state === "waiting" && app.account.may("survey") && h("button", { type: "button", class: "small primary", onclick: place }, "Give waypoints"),
    one.state === "open" && h("button", { type: "button", class: "small", onclick: end }, "End now"),
  ];
}

/** A dialog: the moments that were annotated, each put on the plan (or out of it); true if they were sent. */
async function placeWalk(app, recording) {
  const level = await app.api.get(`/v1/levels/${recording.level_id}`);
  const { markers } = await app.api.get(`/v1/levels/${level.id}/markers`);
  const view = await levelPlan(app, level);
  const places = recording.annotations.map(({ text }) => markers.find((one) => one.name.toLowerCase() === text.trim().toLowerCase()) ?? null).map((one) => one && { x: one.x, y: one.y });
  const sent = await dialog("Where was the phone?", (close) => placing(app, { recording, view, places, close }), { wide: true });
  view.destroy();
  return sent;
}

function placing(app, { recording, view, places, close }) {
  let chosen = Math.max(0, places.indexOf(null));
  const list = h("ul", { class: "markers" });
  const send = h("button", { type: "button", class: "primary" }, "Make a walk of it");
  const layer = view.add(placesLayer(places));
  const draw = () => {
    layer.chosen = chosen;
    view.redraw();
    send.disabled = places.filter(Boolean).length < 2;
    replace(list, recording.annotations.map((note, i) => h(
      "li",
      {},
      h("button", { type: "button", class: "link", "aria-pressed": String(i === chosen), onclick: () => { chosen = i; draw(); } }, `${timeOfDay(note.t_ms)} ${note.text || "without a text"}`),
      h("span", { class: "soft" }, places[i] ? `${places[i].x.toFixed(1)}, ${places[i].y.toFixed(1)} m` : "not placed"),
    )));
  };
  view.onpick = ({ x, y }) => {
    places[chosen] = { x, y };
    const next = places.indexOf(null);
    if (next >= 0) chosen = next;
    draw();
  };
  send.addEventListener("click", async () => {
    const kept = recording.annotations.map((note, i) => [note.t_ms, places[i]]).filter(([, place]) => place);
    const columns = { t_ms: kept.map(([t]) => t), x: kept.map(([, one]) => one.x), y: kept.map(([, one]) => one.y) };
    try {
      await app.api.put(`/v1/recordings/${recording.id}/waypoints`, columns);
      toast("A walk was made of it.", { kind: "good" });
      close(true);
    } catch (error) {
      toastError(error);
    }
  });
  draw();
  return [
    recording.annotations.length < 2 && h("p", { class: "problem" }, "Fewer than two moments were annotated: nothing says when the phone was where. Walk once more, and annotate at two known points at least."),
    h("p", { class: "soft" }, "Choose a moment, then click on the plan where the phone was (or Enter at the crosshair)."),
    view.element,
    list,
    h("div", { class: "actions" }, h("button", { type: "button", onclick: () => close(null) }, "Cancel"), send),
  ];
}

function placesLayer(places) {
  return {
    visible: true, chosen: 0,
    draw(context, view) {
      context.strokeStyle = colour("accent");
      context.lineWidth = 2;
      context.beginPath();
      for (const one of places.filter(Boolean)) context.lineTo(...view.pixel(one.x, one.y));
      context.stroke();
      places.forEach((one, i) => {
        if (!one) return;
        const [x, y] = view.pixel(one.x, one.y);
        context.fillStyle = colour(i === this.chosen ? "second" : "accent");
        context.beginPath();
        context.arc(x, y, 5, 0, 2 * Math.PI);
        context.fill();
        haloText(context, String(i + 1), x + 7, y - 7);
      });
    },
  };
}
