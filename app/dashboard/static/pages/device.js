// One device: what is known about its magnetometer, phones' addresses, what they recorded, its sessions.

import { calibrationsCard } from "../device/calibrations.js";
import { recordingsCard } from "../device/recordings.js";
import { tokensCard } from "../device/tokens.js";
import { ago, dateTime, duration, empty, facts, h, number, pager, shortId, table } from "../ui.js";
import { levelNames } from "./level_names.js";

export const title = "Device";

export async function render(root, params, app) {
  const [device, names] = await Promise.all([app.api.get(`/v1/devices/${params.device_id}`), levelNames(app)]);
  app.setTitle(device.name);
  const tokens = tokensCard(app, device, names);
  const recordings = recordingsCard(app, device);
  root.append(
    h("div", { class: "page-head" }, h("p", { class: "crumbs" }, h("a", { href: "#/devices" }, "Devices")), h("h1", {}, device.name)),
    h(
      "div",
      { class: "level-columns" },
      h("div", { class: "stack" }, tokens.element, recordings.element, sessionsCard(app, device, names)),
      h("div", { class: "stack" }, aboutCard(device), calibrationsCard(app, device)),
    ),
  );
  recordings.begin();
  return () => recordings.destroy();
}

function aboutCard(device) {
  return h("section", { class: "card", "aria-label": "About the device" }, facts([
    ["Model", device.model ?? "not told"],
    ["Registered", dateTime(device.created_at)],
    ["Id", h("code", {}, device.id)],
  ]));
}

function sessionsCard(app, device, names) {
  const lasted = (one) => ((one.closed_at ? new Date(one.closed_at) : new Date()) - new Date(one.created_at)) / 1000;
  const draw = (items) => table(
    [
      { head: "Session", cell: (one) => h("a", { href: `#/sessions/${one.id}`, title: one.id }, shortId(one.id)) },
      { head: "Level", cell: (one) => names.get(one.level_id)?.name ?? "any level" },
      { head: "Status", cell: (one) => h("span", { class: `badge ${one.status === "open" ? "good" : ""}` }, one.status) },
      { head: "Segments", number: true, cell: (one) => number(one.next_seq) },
      { head: "Open for", number: true, cell: (one) => duration(lasted(one)) },
      { head: "Opened", cell: (one) => h("time", { datetime: one.created_at, title: dateTime(one.created_at) }, ago(one.created_at)) },
    ],
    items,
    { caption: "Sessions of the device" },
  );
  return h("section", { class: "card", "aria-label": "Sessions" }, h("h2", {}, "Sessions"), pager({
    pages: app.api.pages("/v1/sessions", { device_id: device.id, limit: 20 }),
    render: draw,
    empty: empty("No sessions yet", "They begin with what is known here, and add to it when they are closed."),
  }));
}
