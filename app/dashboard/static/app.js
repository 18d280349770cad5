// The shell: sign-in, navigation, and a router that draws one page at a time.

import { forget, signIn, storedSecret } from "./account.js";
import { keepFocus } from "./focus.js";
import { HOME, pages } from "./pages/index.js";
import { nextTheme, themeName } from "./theming.js";
import { empty, form, h, icon, loading, problem, replace, toast, toastRegion } from "./ui.js";

const main = h("main", { id: "main", tabindex: "-1" });
keepFocus(main);
const announcer = h("div", { class: "visually-hidden", "aria-live": "polite", role: "status" });
let account = null;
let leave = () => {};
let turn = 0;

/** What pages get. */
const app = {
  /** Calls that end when the page is left. */
  api: null,
  /** Who is signed in: `app.account.may("survey")`. */
  get account() { return account; },
  /** The part after "?" of the address. */
  query: new URLSearchParams(),
  /** Open another page. */
  go(path) { location.hash = `#${path}`; },
  /** Draw the page anew. */
  reload() { show(); },
  /** Change the part after "?" without opening the page anew, so that a link to it shows the same. */
  setQuery(values) {
    for (const [name, value] of Object.entries(values)) {
      if (value === null || value === undefined || value === "") app.query.delete(name);
      else app.query.set(name, value);
    }
    const text = app.query.toString();
    history.replaceState(null, "", `${location.hash.split("?")[0]}${text ? `?${text}` : ""}`);
  },
  /** Name the page, in the window's title and for screen readers. */
  setTitle(text) {
    document.title = text ? `${text} · Isodyn` : "Isodyn";
  },
  /** Say something to screen readers only. */
  announce(text) { announcer.textContent = text; },
};

function match(path) {
  const parts = path.split("/").filter(Boolean);
  for (const page of pages) {
    const wanted = page.path.split("/").filter(Boolean);
    if (wanted.length !== parts.length) continue;
    const params = {};
    const fits = wanted.every((part, i) => {
      if (part.startsWith(":")) params[part.slice(1)] = decodeURIComponent(parts[i]);
      return part.startsWith(":") || part === parts[i];
    });
    if (fits) return { page, params };
  }
  return null;
}

async function show() {
  const mine = ++turn;
  leave();
  const [path, query = ""] = (location.hash.slice(1) || HOME).split("?");
  const found = match(path);
  const abort = new AbortController();
  leave = () => abort.abort();
  app.query = new URLSearchParams(query);
  app.api = account.api.scoped(abort.signal);
  markNavigation(found?.page);
  document.body.classList.remove("menu-open");
  const root = h("div", { class: "page" });
  replace(main, root);
  const refusal = refused(found, path);
  if (refusal) {
    app.setTitle(null);
    root.dataset.ready = "";
    return replace(root, refusal);
  }
  replace(root, loading());
  try {
    const module = await found.page.load();
    if (mine !== turn) return undefined;
    const title = typeof module.title === "function" ? module.title(found.params) : module.title;
    app.setTitle(title);
    replace(root);
    // A page keeps its own view of the app: calls of a page that was left end with it.
    const cleanup = await module.render(root, found.params, Object.create(app, { api: { value: app.api }, signal: { value: abort.signal } }));
    const end = () => { abort.abort(); cleanup?.(); };
    if (mine === turn) leave = end;
    else end();
    root.dataset.ready = "";
    app.announce(document.title);
  } catch (error) {
    if (error.name !== "AbortError") {
      if (mine === turn) {
        replace(root, problem(error));
        root.dataset.ready = "";
      }
      if (error.name !== "ApiError") throw error;
    }
  }
  return undefined;
}

function refused(found, path) {
  if (!found) return empty("There is no such page", `Nothing is at ${path}.`, h("a", { href: `#${HOME}` }, "To the overview"));
  if (account.may(found.page.scope)) return null;
  return empty("This key may not see that", `The page needs a key with the scope “${found.page.scope}”.`);
}

function markNavigation(page) {
  for (const link of document.querySelectorAll("nav a[data-path]")) {
    if (page && link.dataset.path === (page.under ?? page.path)) link.setAttribute("aria-current", "page");
    else link.removeAttribute("aria-current");
  }
}

function navigation() {
  const groups = new Map();
  for (const page of pages.filter((one) => one.nav && account.may(one.scope))) {
    if (!groups.has(page.group)) groups.set(page.group, []);
    groups.get(page.group).push(page);
  }
  return h(
    "nav",
    { "aria-label": "Pages", id: "navigation" },
    [...groups].map(([name, members]) => h(
      "section",
      {},
      h("h2", {}, name),
      h("ul", {}, members.map((page) => h("li", {}, h("a", { href: `#${page.path}`, dataset: { path: page.path } }, icon(page.icon), page.name)))),
    )),
  );
}

function themeButton() {
  const words = () => `Colours: ${themeName()}`;
  const draw = () => replace(button, icon(themeName() === "dark" ? "moon" : "sun"), h("span", {}, words()));
  const button = h("button", { type: "button", class: "quiet", onclick: () => { nextTheme(); draw(); } });
  draw();
  return button;
}

function brand() {
  return h("a", { class: "brand", href: `#${HOME}` }, h("img", { src: "/static/icon.svg", alt: "", width: 28, height: 28 }), "Isodyn");
}

function frame() {
  const toggleMenu = () => {
    const open = document.body.classList.toggle("menu-open");
    menu.setAttribute("aria-expanded", String(open));
  };
  const menu = h("button", { type: "button", class: "quiet menu", "aria-controls": "navigation", "aria-expanded": "false", "aria-label": "Menu", onclick: toggleMenu }, icon("menu"));
  const skip = h("a", { class: "skip", href: "#main", onclick: (event) => { event.preventDefault(); main.focus(); } }, "Skip to the content");
  replace(
    document.body,
    skip,
    h(
      "div",
      { class: "shell" },
      h(
        "header",
        { class: "side" },
        h("div", { class: "side-top" }, brand(), menu),
        navigation(),
        h(
          "div",
          { class: "side-foot" },
          themeButton(),
          h("a", { class: "button quiet", href: "/docs" }, icon("link"), "API"),
          h("p", { class: "who" }, h("b", {}, account.key.name), h("span", {}, account.key.scopes.join(", "))),
          h("button", { type: "button", class: "quiet", onclick: signOut }, icon("out"), "Sign out"),
        ),
      ),
      main,
    ),
    toastRegion(),
    announcer,
  );
}

function signInPage(message = null) {
  leave();
  turn += 1;
  account = null;
  document.title = "Sign in · Isodyn";
  const enter = async ({ key }) => {
    account = await signIn(key.trim(), rejected);
    begin();
  };
  const entry = form(
    [{
      name: "key", label: "API key", type: "password", required: true, autocomplete: "off", placeholder: "isk_…", spellcheck: "false",
      hint: "The first start of the service printed an admin key. It stays in this tab, and is forgotten when the tab is closed.",
    }],
    enter,
    { submit: "Sign in" },
  );
  replace(
    document.body,
    h(
      "main",
      { class: "sign-in" },
      h("div", { class: "card" }, h("div", { class: "brand" }, h("img", { src: "/static/icon.svg", alt: "", width: 40, height: 40 }), h("h1", {}, "Isodyn")),
        h("p", { class: "lead" }, "Positions from the Earth’s magnetic field."),
        message && problem(message), entry),
      h("p", { class: "small" }, h("a", { href: "/docs" }, "API documents")),
    ),
    toastRegion(),
    announcer,
  );
  entry.querySelector("input").focus();
}

function rejected(error) {
  if (account === null) return;
  forget();
  signInPage(error);
}

function signOut() {
  forget();
  signInPage();
}

function begin() {
  frame();
  show();
}

async function start() {
  const secret = storedSecret();
  if (secret === null) return signInPage();
  try {
    account = await signIn(secret, rejected);
  } catch (error) {
    if (error.status === 401) forget();
    return signInPage(error);
  }
  return begin();
}

window.addEventListener("hashchange", () => {
  if (account === null) return;
  show();
  main.focus({ preventScroll: true });
  window.scrollTo(0, 0);
});
window.addEventListener("unhandledrejection", (event) => {
  if (event.reason?.name === "AbortError") event.preventDefault();
  else if (event.reason?.name === "ApiError") {
    event.preventDefault();
    toast(event.reason.message, { kind: "error" });
  }
});
document.addEventListener("keydown", (event) => {
  if (event.key === "Escape") document.body.classList.remove("menu-open");
});
start();
