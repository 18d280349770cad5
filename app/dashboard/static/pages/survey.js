// One survey: files in, walks on the plan, a map from them.

import { confirm, dateTime, download, duration, empty, fill, h, icon, metres, number, replace, table, toast, toastError } from "../ui.js";
import { levelPlan } from "../plans.js";
import { mapDialog } from "./survey_map.js";
import { uploadCard } from "./survey_upload.js";
import { lineLayer } from "./walk_lines.js";

export const title = "Survey";

export async function render(root, params, app) {
  const survey = await app.api.get(`/v1/surveys/${params.survey_id}`);
  const level = await app.api.get(`/v1/levels/${survey.level_id}`);
  app.setTitle(survey.name);
  const plan = await levelPlan(app, level, { label: `Walks of ${survey.name}` });
  const lines = plan.add(lineLayer());
  const walks = h("div", {});
  const counted = h("p", {});
  const reload = () => fill(walks, async () => {
    const [items, places] = await Promise.all([
      app.api.all(`/v1/surveys/${survey.id}/walks`), app.api.all(`/v1/levels/${level.id}/waypoints`, { survey_id: survey.id }),
    ]);
    lines.lines = places.map((one) => ({ ...one, id: one.walk_id }));
    lines.chosen = null;
    plan.redraw();
    const length = items.reduce((sum, walk) => sum + walk.length_m, 0);
    replace(counted, `${number(items.length)} walks, ${metres(length)}, made ${dateTime(survey.created_at)}`);
    return walkTable(items, { plan, lines, remove: (walk) => remove(app, survey, walk, reload) });
  });
  plan.onpick = (place) => choose(plan, lines, lines.nearest(place, 12 / plan.scale), walks);
  root.append(
    h(
      "div",
      { class: "page-head" },
      h("p", { class: "crumbs" }, h("a", { href: `#/surveys?level_id=${level.id}` }, "Surveys"), " / ", h("a", { href: `#/levels/${level.id}` }, level.name)),
      h("div", {}, h("h1", {}, survey.name), counted),
      h(
        "div",
        { class: "row" },
        h("button", { type: "button", onclick: () => takeHome(app, survey) }, icon("download"), "Export"),
        h("button", { type: "button", class: "primary", onclick: () => mapDialog(app, survey, level) }, icon("layers"), "Make a map"),
      ),
    ),
    uploadCard(app, survey, { done: reload, preview: (found) => { lines.tried = found; plan.redraw(); } }),
    h(
      "div",
      { class: "columns" },
      h("section", { class: "card" }, h("h2", {}, "Where the walks went"), plan.element),
      h("section", { class: "card" }, h("h2", {}, "Walks"), walks),
    ),
  );
  await reload();
  return () => plan.destroy();
}

function walkTable(items, { plan, lines, remove }) {
  if (!items.length) return empty("No walks yet", "Upload recordings above: walks with at least two known positions.");
  const show = (id) => choose(plan, lines, id);
  return table(
    [
      { head: "Walk", cell: (walk) => h("button", { type: "button", class: "link", onclick: () => show(walk.id) }, walk.name) },
      { head: "Length", number: true, cell: (walk) => metres(walk.length_m) },
      { head: "Time", number: true, cell: (walk) => duration(walk.duration_s) },
      { head: "Positions", number: true, cell: (walk) => walk.n_waypoints },
      { head: "", cell: (walk) => h("button", { type: "button", class: "quiet small", "aria-label": `Delete ${walk.name}`, title: "Delete", onclick: () => remove(walk) }, icon("trash")) },
    ],
    items,
    { caption: "Walks", row: (walk) => ({ dataset: { walk: walk.id }, onmouseenter: () => { lines.near = walk.id; plan.redraw(); }, onmouseleave: () => { lines.near = null; plan.redraw(); } }) },
  );
}

function choose(plan, lines, id, list = null) {
  lines.chosen = id;
  const line = lines.lines.find((one) => one.id === id);
  if (line) plan.reveal(line.x[0], line.y[0]);
  list?.querySelector(`[data-walk="${id}"]`)?.scrollIntoView({ block: "nearest" });
  for (const row of plan.element.closest(".page").querySelectorAll("[data-walk]")) {
    row.classList.toggle("chosen", row.dataset.walk === id);
  }
  plan.redraw();
}

async function remove(app, survey, walk, reload) {
  const sure = await confirm(`Delete ${walk.name}?`, "Its samples are deleted for good. Maps built from it stay as they are, until the next update takes it out.", { action: "Delete", danger: true });
  if (!sure) return;
  try {
    await app.api.delete(`/v1/surveys/${survey.id}/walks/${walk.id}`);
    toast(`${walk.name} was deleted.`);
  } catch (error) {
    toastError(error);
  }
  await reload();
}

async function takeHome(app, survey) {
  try {
    download(`${survey.name}.zip`, await app.api.blob(`/v1/surveys/${survey.id}/export`));
  } catch (error) {
    toastError(error);
  }
}
