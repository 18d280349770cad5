// A plan picture put in its place: by its edges, or by two points whose coordinates are known.

import { PlanView, haloText, pictureLayer } from "../../canvas.js";
import { colour } from "../../theming.js";
import { dialog, empty, field, form, h, replace, toast } from "../../ui.js";

const MOST_PIXELS = 4096;

/**
 * The similarity that takes two points of a picture to two places: z -> a z + b in complex numbers, with the picture's
 * v axis pointing up.
 *
 * @param {{u, v}[]} points  pixels, v from the lower edge
 * @param {{x, y}[]} places  metres
 */
export function similarity([p, q], [from, to]) {
  const [du, dv] = [q.u - p.u, q.v - p.v];
  const [dx, dy] = [to.x - from.x, to.y - from.y];
  const square = du * du + dv * dv;
  const a = { re: (dx * du + dy * dv) / square, im: (dy * du - dx * dv) / square };
  const b = { x: from.x - (a.re * p.u - a.im * p.v), y: from.y - (a.im * p.u + a.re * p.v) };
  return { a, b, scale: Math.hypot(a.re, a.im), angle: Math.atan2(a.im, a.re) };
}

/** Draw a picture where a similarity puts it, onto a canvas that covers a rectangle in metres. */
export function placed(image, { a, b, scale }, extent) {
  const width = extent.x_max - extent.x_min;
  const height = extent.y_max - extent.y_min;
  // as fine as the picture, within what a plan may have
  const density = Math.min(1 / scale, MOST_PIXELS / Math.max(width, height));
  const canvas = document.createElement("canvas");
  canvas.width = Math.max(1, Math.round(width * density));
  canvas.height = Math.max(1, Math.round(height * density));
  const context = canvas.getContext("2d");
  context.scale(canvas.width / width, canvas.height / height);
  context.transform(1, 0, 0, -1, -extent.x_min, extent.y_max);
  context.transform(a.re, a.im, -a.im, a.re, b.x, b.y);
  context.transform(1, 0, 0, -1, 0, image.height);
  context.imageSmoothingQuality = "high";
  context.drawImage(image, 0, 0);
  return canvas;
}

/** The rectangle of whole metres around a picture that a similarity puts in place. */
export function reach(image, { a, b }) {
  const corners = [[0, 0], [image.width, 0], [0, image.height], [image.width, image.height]];
  const xs = corners.map(([u, v]) => a.re * u - a.im * v + b.x);
  const ys = corners.map(([u, v]) => a.im * u + a.re * v + b.y);
  return {
    x_min: Math.floor(Math.min(...xs)), y_min: Math.floor(Math.min(...ys)),
    x_max: Math.ceil(Math.max(...xs)), y_max: Math.ceil(Math.max(...ys)),
  };
}

/** Ask for a picture and where it lies, and send it; true if it was. */
export function placePlan(app, level) {
  return dialog(`Plan picture of ${level.name}`, (close) => {
    const state = { image: null, file: null, points: [] };
    const stage = h("div", {}, empty("Choose a picture", "It is shown here, to be placed by two points."));
    const hint = h("p", { class: "soft small", role: "status" });
    const entry = form(
      [
        { name: "picture", label: "Picture (PNG)", type: "file", accept: "image/png", required: true },
        { name: "how", label: "Where it lies", type: "select", value: "edges", options: [["edges", "Its edges are those of the level"], ["points", "By two points whose coordinates I know"]] },
        stage,
        hint,
        h("div", { class: "fields" }, pointFields("a", "First point"), pointFields("b", "Second point")),
        { name: "grow", label: "Make the level as large as the picture", type: "checkbox", value: false },
      ],
      async (values) => {
        await send(app, level, state, { ...values, a: readPoint(entry, "a"), b: readPoint(entry, "b") });
        toast("The plan was saved.", { kind: "good" });
        close(true);
      },
      { submit: "Save the plan", cancel: () => close(null) },
    );
    const byPoints = () => entry.fieldOf("how").input.value === "points";
    const update = () => {
      for (const one of [...entry.querySelectorAll("fieldset"), entry.fieldOf("grow")]) one.hidden = !byPoints();
      hint.textContent = byPoints() && state.image
        ? ["Click the first point on the picture.", "Click the second point.", "Both points are set; click again to start anew."][state.points.length]
        : "";
    };
    entry.fieldOf("how").input.addEventListener("change", update);
    entry.fieldOf("picture").input.addEventListener("change", async (event) => {
      [state.file] = event.target.files;
      state.image = state.file ? await createImageBitmap(state.file) : null;
      state.points = [];
      if (state.image) replace(stage, pictureView(state, update));
      update();
    });
    update();
    return [entry];
  }, { wide: true });
}

function pointFields(name, words) {
  return h(
    "fieldset",
    { class: "point" },
    h("legend", {}, words),
    h("div", { class: "fields" }, ["x", "y"].map((axis) => field({ name: `${name}.${axis}`, label: `${axis}, m`, type: "number" }))),
  );
}

function readPoint(entry, name) {
  const [x, y] = ["x", "y"].map((axis) => entry.querySelector(`[name="${name}.${axis}"]`).valueAsNumber);
  return { x, y };
}

function pictureView(state, onchange) {
  const { image } = state;
  const extent = { x_min: 0, y_min: 0, x_max: image.width, y_max: image.height };
  const view = new PlanView({ label: "The picture", extent, unit: "px" });
  view.element.classList.add("small");
  view.add(pictureLayer(image, extent));
  view.add({
    draw(context) {
      state.points.forEach(({ u, v }, i) => {
        const [px, py] = view.pixel(u, v);
        context.fillStyle = colour("bad");
        context.beginPath();
        context.arc(px, py, 5, 0, 2 * Math.PI);
        context.fill();
        haloText(context, ["First", "Second"][i], px + 8, py + 4);
      });
    },
  });
  view.onpick = ({ x, y }) => {
    if (state.points.length === 2) state.points = [];
    state.points.push({ u: x, v: y });
    onchange();
    view.redraw();
  };
  return view.element;
}

async function send(app, level, state, { how, a, b, grow }) {
  let body = state.file;
  if (how === "points") {
    if (state.points.length < 2) throw new Error("Click two points on the picture first.");
    if (![a.x, a.y, b.x, b.y].every(Number.isFinite)) throw new Error("Give x and y of both points, in metres of the level.");
    if (Math.hypot(a.x - b.x, a.y - b.y) < 0.5) throw new Error("The two points must lie apart: the further, the better.");
    const where = similarity(state.points, [a, b]);
    const extent = grow ? reach(state.image, where) : level.extent;
    if (grow) await app.api.patch(`/v1/levels/${level.id}`, { extent });
    const canvas = placed(state.image, where, extent);
    body = await new Promise((resolve) => canvas.toBlob(resolve, "image/png"));
  }
  await app.api.fetch("PUT", `/v1/levels/${level.id}/plan.png`, { body, headers: { "Content-Type": "image/png" } });
}
