// Keys: who may call, with what scopes; made, rotated and revoked. A secret is shown once.

import { signIn } from "../account.js";
import { ago, confirm, dateTime, dialog, empty, field, form, h, icon, pager, table, toast, toastError } from "../ui.js";

export const title = "Keys";

const SCOPES = [
  ["locate", "locate: sessions, devices, one-shot location"],
  ["survey", "survey: venues, surveys, maps"],
  ["admin", "admin: keys, statistics, and all of the others"],
];

export async function render(root, params, app) {
  const list = h("div", {});
  const draw = () => list.replaceChildren(pager({
    pages: app.api.pages("/v1/keys", { limit: 100 }),
    render: (items) => keyTable(app, items, draw),
    empty: empty("No keys", "There is always one: the one that looks at this page."),
  }));
  root.append(
    h(
      "div",
      { class: "page-head" },
      h("h1", {}, "Keys"),
      h("button", { type: "button", class: "primary", onclick: () => create(app, draw) }, icon("plus"), "New key"),
      h("p", {}, "A device needs a key with the scope locate, a surveyor’s tool survey as well. What is stored of a key is its hash: a lost secret cannot be shown again, only replaced."),
    ),
    h("section", { class: "card" }, list),
  );
  draw();
}

function keyTable(app, items, draw) {
  const own = app.account.key.id;
  return table(
    [
      { head: "Name", cell: (key) => [h("b", {}, key.name), key.id === own && h("span", { class: "badge accent" }, "this tab’s")] },
      { head: "Scopes", cell: (key) => h("span", { class: "row start" }, key.scopes.map((scope) => h("span", { class: "badge" }, scope))) },
      { head: "Created", cell: (key) => moment(key.created_at) },
      { head: "Last used", cell: (key) => (key.last_used_at ? moment(key.last_used_at) : h("span", { class: "soft" }, "never")) },
      { head: "State", cell: (key) => (key.revoked_at ? h("span", { class: "badge bad", title: dateTime(key.revoked_at) }, "revoked") : h("span", { class: "badge good" }, "works")) },
      { head: "", cell: (key) => !key.revoked_at && actions(app, key, draw) },
    ],
    items,
    { caption: "Keys", row: (key) => ({ dataset: { key: key.id } }) },
  );
}

function moment(iso) {
  return h("time", { datetime: iso, title: dateTime(iso) }, ago(iso));
}

function actions(app, key, draw) {
  return h(
    "span",
    { class: "cell-actions" },
    h("button", { type: "button", class: "small", onclick: () => rotate(app, key, draw), "aria-label": `Rotate ${key.name}` }, "Rotate"),
    h("button", { type: "button", class: "small danger", onclick: () => revoke(app, key, draw), "aria-label": `Revoke ${key.name}` }, "Revoke"),
  );
}

async function create(app, draw) {
  const boxes = SCOPES.map(([name, label]) => field({ name: `scope.${name}`, label, type: "checkbox", value: name === "locate" }));
  const made = await dialog("New key", (close) => form(
    [
      { name: "name", label: "Name", required: true, maxlength: 200, hint: "Who or what will use it.", autocomplete: "off" },
      h("p", { class: "small soft" }, "What it may do:"),
      ...boxes,
    ],
    async ({ name, scope }) => {
      const scopes = SCOPES.map(([one]) => one).filter((one) => scope[one]);
      if (!scopes.length) return boxes[0].showError("Choose at least one.");
      return close(await app.api.post("/v1/keys", { name, scopes }));
    },
    { submit: "Create", cancel: () => close(null) },
  ));
  if (!made) return;
  await showSecret(made, `${made.name} was created`);
  draw();
}

// A new key of the same name and scopes first, then the old one goes: in between both work, so nothing stands still.
async function rotate(app, key, draw) {
  const sure = await confirm(`Rotate ${key.name}?`, "A new key with the same name and scopes is made and its secret shown. The old one works until you revoke it, which comes next.", { action: "Make a new key" });
  if (!sure) return;
  try {
    const made = await app.api.post("/v1/keys", { name: key.name, scopes: key.scopes });
    const done = await showSecret(made, `A new key for ${key.name}`, "Put it where the old one was used, then revoke the old one.", "Revoke the old key");
    if (done && (await exchange(app, key, made))) return;
  } catch (error) {
    toastError(error);
  }
  draw();
}

/** Revoke the old key; true if the page is loaded anew with the new one. */
async function exchange(app, key, made) {
  const own = key.id === app.account.key.id;
  // this tab goes on with the new key, or it would be signed out by its own doing
  if (own) await signIn(made.secret);
  await app.api.delete(`/v1/keys/${key.id}`);
  if (own) location.reload();
  else toast(`The old key of ${key.name} is revoked.`, { kind: "good" });
  return own;
}

async function revoke(app, key, draw) {
  const own = key.id === app.account.key.id;
  const text = `Whoever uses ${key.name} is refused from now on. This cannot be undone.${own ? " It is the key of this tab: you will be signed out." : ""}`;
  if (!(await confirm(`Revoke ${key.name}?`, text, { action: "Revoke", danger: true }))) return;
  try {
    await app.api.delete(`/v1/keys/${key.id}`);
    toast(`${key.name} is revoked.`, { kind: "good" });
  } catch (error) {
    toastError(error);
  }
  draw();
}

/** Show a secret, the only time; true if the reader chose `further`. */
function showSecret(made, heading, text = null, further = null) {
  const input = h("input", { readonly: true, value: made.secret, "aria-label": "Secret", spellcheck: "false", onfocus: (event) => event.target.select() });
  const said = h("span", { role: "status", class: "small" });
  const copy = async () => {
    input.select();
    try {
      // not there on pages that came over plain HTTP from another machine
      await navigator.clipboard.writeText(made.secret);
      said.textContent = "Copied.";
    } catch {
      said.textContent = "It is selected: copy it by hand.";
    }
  };
  return dialog(heading, (close) => [
    h("p", {}, "This is the only time that its secret is shown. ", text),
    h("div", { class: "secret" }, input, h("button", { type: "button", class: "primary", onclick: copy }, "Copy")),
    said,
    h(
      "div",
      { class: "actions" },
      further && h("button", { type: "button", class: "danger", onclick: () => close(true) }, further),
      h("button", { type: "button", onclick: () => close(false) }, further ? "Later" : "I have it"),
    ),
  ]);
}
