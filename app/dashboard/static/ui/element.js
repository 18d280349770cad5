// Elements from plain values. Text is always text: nothing here parses HTML, so an answer cannot smuggle any in.

const SVG = "http://www.w3.org/2000/svg";
const SVG_TAGS = new Set(["svg", "path", "circle", "line", "rect", "g"]);
let lastId = 0;

/**
 * Build an element.
 *
 * h("button", {class: "primary", onclick: save, "aria-label": "Save"}, "Save")
 *
 * @param {string} tag
 * @param {object} attributes  on... are listeners; `class`, `dataset`, `style` (object) and properties that start
 *     with a dot (".value") are set as such; true is an attribute without a value, null, undefined and false are none.
 * @param {...(Node|string|number|null|undefined|false|Array)} children
 */
export function h(tag, attributes = {}, ...children) {
  const element = SVG_TAGS.has(tag) ? document.createElementNS(SVG, tag) : document.createElement(tag);
  for (const [name, value] of Object.entries(attributes ?? {})) set(element, name, value);
  element.append(...flat(children));
  return element;
}

function set(element, name, value) {
  if (value === null || value === undefined || value === false) return;
  if (name.startsWith("on")) element.addEventListener(name.slice(2).toLowerCase(), value);
  else if (name === "dataset") Object.assign(element.dataset, value);
  else if (name === "style") for (const [key, text] of Object.entries(value)) element.style.setProperty(key, text);
  else if (name.startsWith(".")) element[name.slice(1)] = value;
  else element.setAttribute(name, value === true ? "" : String(value));
}

function flat(children) {
  return children
    .flat(Infinity)
    .filter((child) => child !== null && child !== undefined && child !== false)
    .map((child) => (child instanceof Node ? child : String(child)));
}

/** Put these children in place of all that an element holds. */
export function replace(element, ...children) {
  element.replaceChildren(...flat(children));
  return element;
}

/** An id that no other element has. */
export function uniqueId(prefix = "id") {
  lastId += 1;
  return `${prefix}-${lastId}`;
}

const ICONS = {
  building: "M4 21V5l8-2v18M12 8l8 2v11M2 21h20M7 8h2M7 12h2M7 16h2M15 13h2M15 17h2",
  layers: "M12 3l9 5-9 5-9-5zM3 12.5l9 5 9-5M3 17l9 5 9-5",
  live: "M12 12m-2 0a2 2 0 104 0 2 2 0 10-4 0M7.5 7.5a6.4 6.4 0 000 9M16.500 7.5a6.4 6.4 0 010 9M4.700 4.700a10.300 10.300 0 000 14.600M19.300 4.700a10.300 10.300 0 010 14.600",
  route: "M6 19m-2 0a2 2 0 104 0 2 2 0 10-4 0M18 5m-2 0a2 2 0 104 0 2 2 0 10-4 0M8 19h8a3 3 0 000-7H8a3 3 0 010-7h8",
  phone: "M8 2h8a1.500 1.500 0 011.500 1.500v17A1.500 1.500 0 0116 22H8a1.500 1.500 0 01-1.500-1.500v-17A1.500 1.500 0 018 2zM11 19h2",
  survey: "M4 20l5-13 5 9 2-4 4 8zM9 7V3l5 2-5 2",
  chart: "M4 4v16h16M8 16v-4M12 16V8M16 16v-6",
  fence: "M5 7l7-4 7 4v10l-7 4-7-4zM12 3v18M5 7l14 10M19 7L5 17",
  key: "M15 9m-5 0a5 5 0 1010 0 5 5 0 10-10 0M11.500 12.500L4 20M6 18l2 2M8.500 15.500l2 2",
  upload: "M12 16V4M7 9l5-5 5 5M4 16v4h16v-4",
  download: "M12 4v12M7 11l5 5 5-5M4 18v2h16v-2",
  jobs: "M12 3v4M12 17v4M3 12h4M17 12h4M5.600 5.600l2.800 2.800M15.600 15.600l2.800 2.800M5.600 18.400l2.800-2.800M15.600 8.400l2.800-2.800",
  sun: "M12 12m-4 0a4 4 0 108 0 4 4 0 10-8 0M12 2v2M12 20v2M2 12h2M20 12h2M5 5l1.400 1.400M17.600 17.600L19 19M5 19l1.400-1.400M17.600 6.400L19 5",
  moon: "M20 14.500A8.500 8.500 0 119.500 4a7 7 0 0010.500 10.500z",
  out: "M14 4H5v16h9M10 12h11M17 8l4 4-4 4",
  menu: "M4 7h16M4 12h16M4 17h16",
  plus: "M12 5v14M5 12h14",
  minus: "M5 12h14",
  fit: "M4 9V4h5M15 4h5v5M20 15v5h-5M9 20H4v-5",
  search: "M10.500 10.500m-6 0a6 6 0 1012 0 6 6 0 10-12 0M15 15l5 5",
  edit: "M4 20h4L19 9l-4-4L4 16zM13 7l4 4",
  trash: "M5 7h14M10 7V4h4v3M7 7l1 13h8l1-13",
  check: "M5 13l4 4L19 7",
  close: "M6 6l12 12M18 6L6 18",
  back: "M14 6l-6 6 6 6",
  link: "M10 14a4 4 0 006 0l3-3a4 4 0 00-6-6l-1 1M14 10a4 4 0 00-6 0l-3 3a4 4 0 006 6l1-1",
  play: "M8 5l11 7-11 7z",
  pause: "M8 5v14M16 5v14",
  pin: "M12 21s7-6.500 7-11.500a7 7 0 10-14 0C5 14.500 12 21 12 21zM12 9.500m-2 0a2 2 0 104 0 2 2 0 10-4 0",
};

/** A drawing of 24 units; it is decoration, so give the control beside it its own words. */
export function icon(name) {
  return h(
    "svg",
    { viewBox: "0 0 24 24", class: "icon", "aria-hidden": "true", focusable: "false" },
    h("path", { d: ICONS[name] ?? ICONS.layers }),
  );
}
