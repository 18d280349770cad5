// Tables, pages of lists, files to take home.

import { h, icon, replace } from "./element.js";
import { loading, problem } from "./messages.js";

/**
 * A table.
 *
 * @param {object[]} columns  head, cell (row -> node or text), number (right-aligned), csv (row -> plain value)
 * @param {object[]} rows
 * @param {object} options  caption (for screen readers), row (row -> attributes of its tr)
 */
export function table(columns, rows, { caption, row = () => ({}) } = {}) {
  return h(
    "div",
    { class: "scroll", tabindex: "0", role: "region", "aria-label": caption },
    h(
      "table",
      {},
      h("caption", { class: "visually-hidden" }, caption),
      h("thead", {}, h("tr", {}, columns.map((column) => h("th", { scope: "col", class: column.number && "number" }, column.head)))),
      h("tbody", {}, rows.map((one) => h("tr", row(one), columns.map((column) => h("td", { class: column.number && "number" }, column.cell(one)))))),
    ),
  );
}

/**
 * A list that the API pages: the first page, and a button for more.
 *
 * @param {object} options  pages (an async iterator of pages of items, as of `api.pages`), render (items -> node),
 *     empty (node shown when there is nothing)
 */
export function pager({ pages, render, empty }) {
  const body = h("div", {});
  const more = h("button", { type: "button", hidden: true }, "Show more");
  const box = h("div", { class: "pager" }, body, more);
  const items = [];
  const next = async () => {
    more.disabled = true;
    if (!items.length) replace(body, loading());
    try {
      const { value, done } = await pages.next();
      items.push(...(value?.items ?? []));
      more.hidden = done || value.next_cursor === null;
      replace(body, items.length ? render(items) : empty);
    } catch (error) {
      if (error.name !== "AbortError") replace(body, problem(error));
    } finally {
      more.disabled = false;
    }
  };
  more.addEventListener("click", next);
  box.ready = next();
  return box;
}

/** Words and values side by side. */
export function facts(pairs) {
  return h(
    "dl",
    { class: "facts" },
    pairs.filter(([, value]) => value !== null && value !== undefined).map(([name, value]) => h("div", {}, h("dt", {}, name), h("dd", {}, value))),
  );
}

/** A number that matters, with its name below. */
export function figure(value, name) {
  return h("div", { class: "figure" }, h("b", {}, value), h("span", {}, name));
}

/** Comma-separated values of RFC 4180; a text that a spreadsheet would run as a formula is made plain. */
export function csvText(columns, rows) {
  const cell = (value) => {
    const plain = value === null || value === undefined ? "" : String(value);
    const safe = typeof value === "string" && /^[=+\-@\t\r]/.test(plain) ? `'${plain}` : plain;
    return /[",\r\n]/.test(safe) ? `"${safe.replaceAll('"', '""')}"` : safe;
  };
  const lines = [columns.map((column) => cell(column.head)), ...rows.map((row) => columns.map((column) => cell((column.csv ?? column.cell)(row))))];
  return lines.map((line) => `${line.join(",")}\r\n`).join("");
}

/** Hand a file to the reader. */
export function download(name, content, type = "application/octet-stream") {
  const url = URL.createObjectURL(content instanceof Blob ? content : new Blob([content], { type }));
  const link = h("a", { href: url, download: name });
  document.body.append(link);
  link.click();
  link.remove();
  // the click only queues the download: an address taken back at once would be gone before it starts
  setTimeout(() => URL.revokeObjectURL(url), 10_000);
}

/** A button that downloads a table. */
export function csvButton(name, columns, rows) {
  return h(
    "button",
    { type: "button", onclick: () => download(name, csvText(columns, rows()), "text/csv;charset=utf-8") },
    icon("download"),
    "CSV",
  );
}
