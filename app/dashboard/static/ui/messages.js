// What the service or a page has to say: toasts, problems, dialogs, empty places.

import { h, icon, replace, uniqueId } from "./element.js";

let toasts = null;

/** Where toasts appear: made once, so that a screen reader already listens when the first one comes. */
export function toastRegion() {
  toasts ??= h("div", { class: "toasts", role: "status", "aria-live": "polite", "aria-atomic": "false" });
  return toasts;
}

/** Say something for some seconds; errors stay until they are closed. */
export function toast(message, { kind = "info", seconds = 6 } = {}) {
  const close = () => box.remove();
  const box = h(
    "div",
    { class: `toast ${kind}`, role: kind === "error" ? "alert" : null },
    h("span", {}, message),
    h("button", { class: "quiet small", "aria-label": "Close this message", onclick: close }, icon("close")),
  );
  toastRegion().append(box);
  if (kind !== "error") setTimeout(close, seconds * 1000);
  return close;
}

/** An error as words: a problem of the API with its fields and remedies, or whatever else was thrown. */
export function problem(error) {
  const fields = error.errors ?? [];
  return h(
    "div",
    { class: "problem", role: "alert" },
    h("strong", {}, error.title ?? "This did not work"),
    h("p", {}, fields.length ? null : (error.detail ?? error.message)),
    fields.length > 0 &&
      h("ul", {}, fields.map((one) => h("li", {}, h("code", {}, one.field), ` ${one.message}: ${one.remedy}`))),
  );
}

/** Show an error as a toast. */
export function toastError(error) {
  if (error.name === "AbortError") return;
  const first = error.errors?.[0];
  toast(first ? `${first.field}: ${first.message}. ${first.remedy}` : (error.detail ?? error.message), {
    kind: "error",
  });
}

/** What stands where nothing is yet, with the way on. */
export function empty(title, text, action = null) {
  return h("div", { class: "empty" }, h("strong", {}, title), text && h("p", {}, text), action);
}

/** A place that is being filled. */
export function loading(text = "Loading…") {
  return h("p", { class: "loading", role: "status" }, text);
}

/**
 * A modal dialog; the promise gives what `close(value)` was called with, null if it was left.
 *
 * @param {string} title
 * @param {(close: (value: any) => void) => Node[]} content
 * @param {object} options  wide (for what needs room, such as a plan)
 */
export function dialog(title, content, { wide = false } = {}) {
  return new Promise((resolve) => {
    const id = uniqueId("dialog");
    let result = null;
    const close = (value) => {
      result = value ?? null;
      box.close();
    };
    const box = h(
      "dialog",
      { "aria-labelledby": id, class: wide && "wide" },
      h(
        "header",
        {},
        h("h2", { id }, title),
        h("button", { class: "quiet small", type: "button", "aria-label": "Close", onclick: () => close(null) }, icon("close")),
      ),
    );
    box.append(...[content(close)].flat());
    box.addEventListener("close", () => {
      box.remove();
      resolve(result);
    });
    document.body.append(box);
    box.showModal();
    // a form is there to be filled in; below a plan it waits
    if (box.children[1]?.matches("form")) box.querySelector("form :is(input, select, textarea):enabled")?.focus();
  });
}

/** Ask before something that matters; true if the answer was yes. */
export async function confirm(title, text, { action = "Go on", danger = false } = {}) {
  const answer = await dialog(title, (close) => [
    h("p", {}, text),
    h(
      "div",
      { class: "actions" },
      h("button", { type: "button", onclick: () => close(null) }, "Cancel"),
      h("button", { type: "button", class: danger ? "danger" : "primary", onclick: () => close(true), autofocus: true }, action),
    ),
  ]);
  return answer === true;
}

/** Run something slow behind a place: loading, then what it gives, or the problem. */
export async function fill(place, work) {
  place.setAttribute("aria-busy", "true");
  try {
    replace(place, await work());
  } catch (error) {
    if (error.name !== "AbortError") replace(place, problem(error));
  } finally {
    place.removeAttribute("aria-busy");
  }
}
