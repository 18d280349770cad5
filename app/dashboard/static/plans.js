// A level's plans in a view of it.

import { PlanView, pictureLayer, vectorLayer } from "./canvas.js";

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
  return pictureLayer(image, level.extent);
}

async function planVector(app, level) {
  return level.has_vector_plan ? vectorLayer(await app.api.get(`/v1/levels/${level.id}/plan.geojson`)) : null;
}
