// A level's plans in a view of it.

import { PlanView, pictureLayer, vectorLayer } from "./canvas.js";
import { isDark } from "./theming.js";

const FAINT = 0.55;

/**
 * A view of a level with its plan image and its vector plan below whatever is added.
 *
 * @returns {Promise<PlanView>}  with `picture` and `vector`, the layers of the plans; null where there is none
 */
export async function levelPlan(app, level, { label = `Plan of ${level.name}` } = {}) {
  const view = new PlanView({ label, extent: level.extent });
  const [picture, vector] = await Promise.all([planPicture(app, level), planVector(app, level)]);
  view.picture = picture && view.add(picture);
  view.vector = vector && view.add(vector);
  return view;
}

async function planPicture(app, level) {
  if (!level.has_plan_image) return null;
  const image = await createImageBitmap(await app.api.blob(`/v1/levels/${level.id}/plan.png`));
  // Plans are drawn on white: at night they are turned over, hues kept. Faint, so that what lies on them stands out.
  let night = null;
  const layer = pictureLayer(image, level.extent, { alpha: FAINT });
  const draw = layer.draw;
  layer.draw = function drawFor(context, view) {
    if (isDark()) night ??= turnedOver(image);
    this.image = isDark() ? night : image;
    draw.call(this, context, view);
  };
  return layer;
}

function turnedOver(image) {
  const canvas = new OffscreenCanvas(image.width, image.height);
  const context = canvas.getContext("2d");
  context.filter = "invert(1) hue-rotate(180deg)";
  context.drawImage(image, 0, 0);
  return canvas;
}

async function planVector(app, level) {
  return level.has_vector_plan ? vectorLayer(await app.api.get(`/v1/levels/${level.id}/plan.geojson`)) : null;
}
