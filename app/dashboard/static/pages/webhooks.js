// Webhooks: who is told of what, whether it arrived, and sending again what did not.

import {
  ago, confirm, dateTime, dialog, empty, field, form, h, icon, pager, replace, select, table, toast, toastError,
} from "../ui.js";

export const title = "Webhooks";

const EVENTS = [
  ["geofence.enter", "A session enters a geofence"], ["geofence.leave", "leaves one"], ["geofence.dwell", "dwells in one"],
  ["map.published", "A map is published"], ["session.closed", "A session is closed"],
];
const STATES = [["", "All"], ["pending", "Waiting"], ["delivered", "Delivered"], ["dead", "Given up"]];
const BADGES = { pending: "warn", delivered: "good", dead: "bad" };

export async function render(root, params, app) {
  const [list, deliveries] = [h("div", {}), h("div", {})];
  const draw = () => list.replaceChildren(pager({
    pages: app.api.pages("/v1/webhooks", { limit: 50 }),
    render: (items) => hookTable(app, items, draw, (hook) => replace(deliveries, deliveriesCard(app, hook))),
    empty: empty("No webhooks", "An address that is told what happens, signed, at least once and in order."),
  }));
  root.append(
    h("div", { class: "page-head" }, h("h1", {}, "Webhooks"), h("button", { type: "button", class: "primary", onclick: () => create(app, draw) }, icon("plus"), "New webhook")),
    h("section", { class: "card", "aria-label": "Webhooks" }, list),
    deliveries,
  );
  draw();
}

function hookTable(app, items, draw, show) {
  const act = (words, work) => async () => {
    try {
      await work();
      if (words) toast(words, { kind: "good" });
      draw();
    } catch (error) {
      toastError(error);
    }
  };
  const path = (hook) => `/v1/webhooks/${hook.id}`;
  const remove = async (hook) => {
    if (await confirm("Delete the webhook?", `${hook.url} is told nothing more, and its deliveries are forgotten.`, { action: "Delete", danger: true })) await act("The webhook is deleted.", () => app.api.delete(path(hook)))();
  };
  const test = (hook) => act("A test message is on its way.", async () => { await app.api.post(`${path(hook)}/test`); show(hook); });
  return table(
    [
      { head: "Address", cell: (hook) => h("button", { type: "button", class: "link", onclick: () => show(hook) }, hook.url) },
      { head: "Told of", cell: (hook) => hook.events.join(", ") },
      { head: "State", cell: (hook) => h("span", { class: `badge ${hook.active ? "good" : ""}` }, hook.active ? "active" : "paused") },
      { head: "Made", cell: (hook) => h("time", { datetime: hook.created_at, title: dateTime(hook.created_at) }, ago(hook.created_at)) },
      {
        head: "",
        cell: (hook) => h(
          "span",
          { class: "cell-actions" },
          h("button", { type: "button", class: "small", onclick: test(hook) }, "Test"),
          h("button", { type: "button", class: "small", onclick: act("", () => app.api.patch(path(hook), { active: !hook.active })) }, hook.active ? "Pause" : "Go on"),
          h("button", { type: "button", class: "small danger", "aria-label": `Delete ${hook.url}`, onclick: () => remove(hook) }, "Delete"),
        ),
      },
    ],
    items,
    { caption: "Webhooks" },
  );
}

function deliveriesCard(app, hook) {
  const place = h("div", {});
  let state = "";
  const draw = () => place.replaceChildren(pager({
    pages: app.api.pages(`/v1/webhooks/${hook.id}/deliveries`, { limit: 50, state }),
    render: (items) => deliveryTable(app, hook, items, draw),
    empty: empty("Nothing was told", "Messages appear here as soon as something happens."),
  }));
  draw();
  return h(
    "section",
    { class: "card", "aria-label": "Deliveries" },
    h("header", {}, h("h2", {}, `Deliveries to ${hook.url}`), h("div", { class: "row" }, select("State", STATES, state, (value) => { state = value; draw(); }), h("button", { type: "button", class: "small", onclick: draw }, "Look again"))),
    place,
  );
}

function deliveryTable(app, hook, items, draw) {
  const again = async (one) => {
    try {
      await app.api.post(`/v1/webhooks/${hook.id}/deliveries/${one.id}/redeliver`);
      toast("It is sent again.", { kind: "good" });
      draw();
    } catch (error) {
      toastError(error);
    }
  };
  return table(
    [
      { head: "Event", cell: (one) => one.event },
      { head: "State", cell: (one) => [h("span", { class: `badge ${BADGES[one.state]}` }, one.state === "dead" ? "given up" : one.state), one.last_error && h("p", { class: "small" }, one.last_error)] },
      { head: "Tried", number: true, cell: (one) => one.attempts },
      { head: "Last", cell: (one) => (one.last_attempt_at ? ago(one.last_attempt_at) : "–") },
      { head: "Happened", cell: (one) => h("time", { datetime: one.created_at, title: dateTime(one.created_at) }, ago(one.created_at)) },
      { head: "", cell: (one) => one.state !== "pending" && h("span", { class: "cell-actions" }, h("button", { type: "button", class: "small", onclick: () => again(one) }, "Send again")) },
    ],
    items,
    { caption: "Deliveries" },
  );
}

async function create(app, draw) {
  const boxes = EVENTS.map(([name, label]) => field({ name, label, type: "checkbox", value: name === "geofence.enter" }));
  const made = await dialog("New webhook", (close) => form(
    [
      { name: "url", label: "Address", required: true, maxlength: 2000, placeholder: "https://example.org/hook", autocomplete: "off", hint: "https, and public, unless the operator allows others." },
      h("p", { class: "small soft" }, "It is told when:"),
      ...boxes,
    ],
    async ({ url }) => {
      const events = boxes.filter((box) => box.input.checked).map((box) => box.input.name);
      if (!events.length) return boxes[0].showError("Choose at least one.");
      return close(await app.api.post("/v1/webhooks", { url, events }));
    },
    { submit: "Create", cancel: () => close(null) },
  ));
  if (!made) return;
  await dialog("The webhook’s secret", (close) => [
    h("p", {}, "It signs every message, and is shown this once. Give it to the receiver."),
    h("div", { class: "secret" }, h("input", { readonly: true, value: made.secret, "aria-label": "Secret", spellcheck: "false", onfocus: (event) => event.target.select() })),
    h("div", { class: "actions" }, h("button", { type: "button", onclick: () => close(true) }, "I have it")),
  ]);
  draw();
}
