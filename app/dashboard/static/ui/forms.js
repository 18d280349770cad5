// Forms: each field has a label, a hint and a place for what the service says against it.

import { h, replace, uniqueId } from "./element.js";
import { problem } from "./messages.js";

/**
 * A field of a form.
 *
 * @param {object} field  name (as the API calls it, "anchor.latitude_deg"), label, type (text, number, checkbox,
 *     select, textarea, file), value, hint, options ([value, text] of a select), half (two stand side by side),
 *     required, and any attribute of the input (min, max, step, accept, placeholder, autocomplete, ...).
 */
export function field({ name, label, type = "text", value, hint, options, half = false, ...attributes }) {
  const id = uniqueId("field");
  const notes = `${id}-notes`;
  const common = { id, name, "aria-describedby": notes, ...attributes };
  const input = control(type, value, options, common);
  const words = h("label", { for: id }, label, attributes.required && h("span", { class: "required", "aria-hidden": "true" }, " *"));
  const note = h("div", { class: "note", id: notes }, hint);
  const box = h("div", { class: `field ${type}${half ? " half" : ""}` }, type === "checkbox" ? [input, words] : [words, input], note);
  box.input = input;
  box.showError = (text) => {
    input.setAttribute("aria-invalid", "true");
    replace(note, h("span", { class: "error" }, text));
  };
  box.clearError = () => {
    input.removeAttribute("aria-invalid");
    replace(note, hint);
  };
  return box;
}

function control(type, value, options, common) {
  if (type === "select") {
    return h(
      "select",
      common,
      options.map(([key, text]) => h("option", { value: key, selected: String(key) === String(value ?? "") }, text)),
    );
  }
  if (type === "textarea") return h("textarea", { rows: 3, ...common }, value ?? "");
  if (type === "checkbox") return h("input", { type, checked: Boolean(value), ...common });
  if (type === "number") return h("input", { type, step: "any", inputmode: "decimal", value: value ?? "", ...common });
  return h("input", { type, value: type === "file" ? null : (value ?? ""), ...common });
}

/** What a field holds, as the API takes it: a number, a truth, a file, a text; null for an empty one. */
export function valueOf(input) {
  if (input.type === "checkbox") return input.checked;
  if (input.type === "file") return input.files[0] ?? null;
  if (input.value === "") return null;
  return input.type === "number" ? input.valueAsNumber : input.value;
}

/**
 * A form that sends itself to the API and puts each error at its field.
 *
 * @param {object[]} fields  as of `field`, or elements that stand between them.
 * @param {(values: object) => Promise<void>} send  values by name; names with dots are nested.
 * @param {object} options  submit (words of the button), cancel (called by a second button).
 */
export function form(fields, send, { submit = "Save", cancel = null } = {}) {
  const boxes = fields.map((one) => (one instanceof Node ? one : field(one)));
  const inputs = boxes.filter((box) => box.input);
  const trouble = h("div", {});
  const button = h("button", { class: "primary", type: "submit" }, submit);
  const element = h(
    "form",
    { novalidate: true },
    boxes,
    trouble,
    h("div", { class: "actions" }, cancel && h("button", { type: "button", onclick: cancel }, "Cancel"), button),
  );
  element.addEventListener("submit", async (event) => {
    event.preventDefault();
    inputs.forEach((box) => box.clearError());
    replace(trouble);
    if (missing(inputs)) return;
    button.disabled = true;
    try {
      await send(nested(inputs.map((box) => [box.input.name, valueOf(box.input)])));
    } catch (error) {
      showProblem(error, inputs, trouble);
    } finally {
      button.disabled = false;
    }
  });
  element.fieldOf = (name) => inputs.find((box) => box.input.name === name);
  return element;
}

function missing(boxes) {
  const bad = boxes.filter((box) => !box.input.checkValidity());
  bad.forEach((box) => box.showError(box.input.validationMessage));
  bad[0]?.input.focus();
  return bad.length > 0;
}

function showProblem(error, boxes, trouble) {
  const left = [];
  for (const one of error.errors ?? []) {
    const box = boxes.find((candidate) => candidate.input.name === one.field);
    if (box) box.showError(`${one.message}: ${one.remedy}`);
    else left.push(one);
  }
  if (!error.errors?.length || left.length) {
    replace(trouble, problem(error.errors?.length ? { title: error.title, errors: left } : error));
  }
  boxes.find((box) => box.input.getAttribute("aria-invalid"))?.input.focus();
}

function nested(pairs) {
  const values = {};
  for (const [name, value] of pairs) {
    const path = name.split(".");
    const last = path.pop();
    let place = values;
    for (const part of path) place = place[part] ??= {};
    place[last] = value;
  }
  return values;
}

/** One of several choices, all in sight: radio buttons that look like one control. */
export function choices(label, options, value, onchange) {
  const name = uniqueId("choice");
  return h(
    "fieldset",
    { class: "choices" },
    h("legend", {}, label),
    h(
      "div",
      { class: "segments" },
      options.map(([key, text]) => {
        const id = uniqueId("option");
        const input = h("input", {
          type: "radio", id, name, value: key, checked: key === value, onchange: () => onchange(key),
        });
        return h("span", {}, input, h("label", { for: id }, text));
      }),
    ),
  );
}

/** A labelled switch. */
export function toggle(label, checked, onchange) {
  const id = uniqueId("toggle");
  const input = h("input", { type: "checkbox", id, checked, onchange: (event) => onchange(event.target.checked) });
  return h("span", { class: "toggle" }, input, h("label", { for: id }, label));
}

/** A labelled select. */
export function select(label, options, value, onchange) {
  const id = uniqueId("select");
  const input = h(
    "select",
    { id, onchange: (event) => onchange(event.target.value) },
    options.map(([key, text]) => h("option", { value: key, selected: key === value }, text)),
  );
  const box = h("span", { class: "labelled" }, h("label", { for: id }, label), input);
  box.input = input;
  return box;
}
