// Light and dark: what the reader chose, or what the system says; and the colours of the style sheet for canvases.

const SLOT = "isodyn.theme";
const ORDER = ["system", "light", "dark"];
const listeners = new Set();
const system = matchMedia("(prefers-color-scheme: dark)");

/** "system", "light" or "dark". */
export function themeName() {
  return document.documentElement.dataset.theme ?? "system";
}

/** Whether the page is dark now. */
export function isDark() {
  return themeName() === "system" ? system.matches : themeName() === "dark";
}

/** Go on to the next of system, light, dark. */
export function nextTheme() {
  const name = ORDER[(ORDER.indexOf(themeName()) + 1) % ORDER.length];
  if (name === "system") {
    delete document.documentElement.dataset.theme;
    localStorage.removeItem(SLOT);
  } else {
    document.documentElement.dataset.theme = name;
    localStorage.setItem(SLOT, name);
  }
  tell();
}

/** Call when the colours change; returns what ends it. */
export function onTheme(listener) {
  listeners.add(listener);
  return () => listeners.delete(listener);
}

let known = new Map();
let probe = null;

/** A colour of the style sheet, such as "accent", as rgb(...): canvases do not understand variables. */
export function colour(name) {
  if (!known.has(name)) {
    if (!probe?.isConnected) {
      probe = document.createElement("span");
      probe.hidden = true;
      document.body.append(probe);
    }
    probe.style.color = `var(--${name})`;
    known.set(name, getComputedStyle(probe).color);
  }
  return known.get(name);
}

function tell() {
  known = new Map();
  for (const listener of listeners) listener();
}

system.addEventListener("change", tell);
