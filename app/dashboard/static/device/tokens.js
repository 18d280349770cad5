// Addresses that phones push to: made for one purpose and place, shown once with a QR code, revoked.

import { ago, confirm, dateTime, dialog, empty, form, h, icon, pager, table, toast, toastError } from "../ui.js";

const APPS = [["sensor-logger", "Sensor Logger"], ["phyphox", "phyphox"]];
const FRAMES = [["android", "Android"], ["ios", "iPhone"], ["standardised", "iPhone, Standardise Units & Frames on"]];
const BUILDS = [["publish", "Update the map and use it"], ["draft", "Build a draft"], ["none", "Nothing: I build it myself"]];
const PURPOSES = { locate: "to be located", survey: "to survey" };

/** The card: `element`. */
export function tokensCard(app, device, names) {
  const list = h("div", {});
  const draw = () => list.replaceChildren(pager({
    pages: app.api.pages("/v1/ingest-tokens", { device_id: device.id, limit: 20 }),
    render: (items) => tokenTable(app, items, names, draw),
    empty: empty("No phone sends as this device", "Sensor Logger and phyphox can: make an address for one of them."),
  }));
  const make = h("button", { type: "button", class: "primary", onclick: () => create(app, device, names, draw) }, icon("plus"), "Connect a phone");
  draw();
  return { element: h("section", { class: "card", "aria-label": "Phones" }, h("header", {}, h("h2", {}, "Phones"), make), list) };
}

function tokenTable(app, items, names, draw) {
  const app_ = new Map(APPS);
  return table(
    [
      { head: "Name", cell: (token) => [h("b", {}, token.name), " ", h("span", { class: "soft" }, app_.get(token.app) ?? token.app)] },
      { head: "For", cell: (token) => `${PURPOSES[token.purpose]}, ${names.get(token.level_id)?.name ?? "any level of the venue"}` },
      { head: "Last used", cell: (token) => (token.last_used_at ? h("time", { datetime: token.last_used_at, title: dateTime(token.last_used_at) }, ago(token.last_used_at)) : h("span", { class: "soft" }, "never")) },
      { head: "", cell: (token) => (token.revoked_at ? h("span", { class: "badge bad" }, "revoked") : h("button", { type: "button", class: "small danger", "aria-label": `Revoke ${token.name}`, onclick: () => revoke(app, token, draw) }, "Revoke")) },
    ],
    items,
    { caption: "Addresses of phones", row: (token) => ({ dataset: { token: token.id } }) },
  );
}

async function revoke(app, token, draw) {
  const text = "Its address is refused from now on, for good. What it sent stays.";
  if (!(await confirm(`Revoke ${token.name}?`, text, { action: "Revoke", danger: true }))) return;
  try {
    await app.api.delete(`/v1/ingest-tokens/${token.id}`);
    toast(`${token.name} is revoked.`, { kind: "good" });
    draw();
  } catch (error) {
    toastError(error);
  }
}

async function create(app, device, names, draw) {
  const made = await dialog("Connect a phone", (close) => tokenForm(app, device, names, close));
  if (!made) return;
  await showAddress(made);
  draw();
}

function tokenForm(app, device, names, close) {
  const may = app.account.may("survey");
  const places = placesOf(names, "locate");
  const purpose = { name: "purpose", label: "What for", type: "select", value: "locate", options: [["locate", "To be located"], ...(may ? [["survey", "To survey: annotations at markers are waypoints"]] : [])] };
  const entry = form(
    [
      { name: "name", label: "Name", required: true, maxlength: 200, value: device.name, autocomplete: "off" },
      { name: "app", label: "Application", type: "select", options: APPS, value: "sensor-logger", half: true },
      { name: "frame", label: "Phone", type: "select", options: FRAMES, value: "android", half: true },
      purpose,
      { name: "place", label: "Where", type: "select", options: places, required: true },
      { name: "build", label: "When a walk has come in", type: "select", options: BUILDS, value: "publish" },
      { name: "contribute", label: "Offer what its sessions see to the maps", type: "checkbox", hint: "Ask the person who carries the phone." },
    ],
    async (values) => close(await app.api.post("/v1/ingest-tokens", bodyOf(device, values))),
    { submit: "Make the address", cancel: () => close(null) },
  );
  const wanted = entry.fieldOf("purpose").input;
  const adapt = () => {
    const survey = wanted.value === "survey";
    const where = entry.fieldOf("place").input;
    const kept = where.value;
    where.replaceChildren(...placesOf(names, wanted.value).map(([key, text]) => h("option", { value: key, selected: key === kept }, text)));
    entry.fieldOf("build").hidden = !survey;
    entry.fieldOf("contribute").hidden = survey;
    // phyphox has no annotations: nothing would say where a walk went
    const apps = entry.fieldOf("app").input;
    if (survey) apps.value = "sensor-logger";
    apps.disabled = survey;
  };
  wanted.addEventListener("change", adapt);
  adapt();
  return entry;
}

// A survey needs its level; to be located, a building is enough.
function placesOf(names, purpose) {
  const levels = [...names].map(([id, { name }]) => [id, name]);
  if (purpose === "survey") return levels;
  const venues = new Map([...names.values()].map(({ level, name }) => [level.venue_id, `${name.split(" · ")[0]}, any level`]));
  return [...levels, ...venues];
}

function bodyOf(device, { name, app, frame, purpose, place, build, contribute }) {
  const where = place.startsWith("ven_") ? { venue_id: place } : { level_id: place };
  const more = purpose === "survey" ? { build } : { contribute };
  return { name, app, frame, purpose, device_id: device.id, ...where, ...more };
}

/** Show an address, the only time. */
export function showAddress(made) {
  const input = h("input", { readonly: true, value: made.url, "aria-label": "Address", spellcheck: "false", onfocus: (event) => event.target.select() });
  const said = h("span", { role: "status", class: "small" });
  const copy = async () => {
    input.select();
    try {
      // not there on pages that came over plain HTTP from another machine
      await navigator.clipboard.writeText(made.url);
      said.textContent = "Copied.";
    } catch {
      said.textContent = "It is selected: copy it by hand.";
    }
  };
  const picture = `data:image/svg+xml,${encodeURIComponent(made.qr_svg)}`;
  const local = ["localhost", "127.0.0.1", "[::1]"].includes(new URL(made.url).hostname);
  return dialog(`${made.name} can send now`, (close) => [
    h("p", {}, "This is the only time that the address is shown: it holds the key."),
    local && h("p", { class: "problem" }, "The address names this very machine. A phone needs one that it can reach: open the dashboard by the machine’s name or number in the network, and make the address there."),
    h("div", { class: "qr" }, h("img", { src: picture, alt: "QR code of the address" })),
    h("div", { class: "secret" }, input, h("button", { type: "button", class: "primary", onclick: copy }, "Copy")),
    said,
    h("h3", {}, "In the application"),
    h("ol", { class: "steps" }, made.settings.map((one) => h("li", {}, one))),
    h("div", { class: "actions" }, h("button", { type: "button", onclick: () => close(true) }, "I have it")),
  ]);
}
