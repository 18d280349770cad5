// Devices: the list, and registering one.

import { ago, dialog, empty, form, h, icon, pager, table, toast } from "../ui.js";

export const title = "Devices";

export async function render(root, params, app) {
  const list = pager({
    pages: app.api.pages("/v1/devices", { limit: 100 }),
    render: deviceTable,
    empty: empty("No devices yet", "A device is one phone, one trolley: what its magnetometer adds to the field is learned and kept with it.", createButton(app)),
  });
  root.append(h("div", { class: "page-head" }, h("h1", {}, "Devices"), createButton(app)), h("section", { class: "card" }, list));
}

function deviceTable(items) {
  return table(
    [
      { head: "Name", cell: (device) => h("a", { href: `#/devices/${device.id}` }, device.name) },
      { head: "Model", cell: (device) => device.model ?? h("span", { class: "soft" }, "not told") },
      { head: "Registered", cell: (device) => h("time", { datetime: device.created_at }, ago(device.created_at)) },
    ],
    items,
    { caption: "Devices" },
  );
}

function createButton(app) {
  return h("button", { type: "button", class: "primary", onclick: () => create(app) }, icon("plus"), "New device");
}

async function create(app) {
  const made = await dialog("New device", (close) => form(
    [
      { name: "name", label: "Name", required: true, maxlength: 200, placeholder: "Ada’s phone", autocomplete: "off" },
      { name: "model", label: "Model", maxlength: 200, placeholder: "Pixel 9", autocomplete: "off", hint: "Devices of one model start with what the others have in common." },
    ],
    async (values) => close(await app.api.post("/v1/devices", values)),
    { submit: "Create", cancel: () => close(null) },
  ));
  if (!made) return;
  toast(`${made.name} is registered.`, { kind: "good" });
  app.go(`/devices/${made.id}`);
}
