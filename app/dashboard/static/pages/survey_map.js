// A map from surveys: build or update, with progress.

import { choices, dialog, field, form, h, replace, toast, valueOf } from "../ui.js";
import { ApiError } from "../api.js";

const MODES = [["update", "Update"], ["build", "Build"]];
const WORDS = {
  update: "The current map gets the walks that it lacks and loses those deleted since; it keeps its settings.",
  build: "A new version from all walks of the level, or from this survey only.",
};

/** Ask how, start the job, show how far it is; the new version is linked when it is there. */
export async function mapDialog(app, survey, level) {
  const mapId = await dialog("Make a map", (close) => content(app, survey, level, close));
  if (mapId) app.go(`/levels/${level.id}?map_id=${mapId}`);
}

function content(app, survey, level, close) {
  let mode = level.current_map_id ? "update" : "build";
  const words = h("p", { class: "soft" });
  const cell = field({ name: "cell_m", label: "Distance of nodes, m", type: "number", min: 0.1, max: 10, value: 0.5 });
  const only = field({ name: "only", label: "From this survey only", type: "checkbox" });
  const draft = field({ name: "draft", label: "As a draft, to be published later", type: "checkbox" });
  const draw = () => {
    replace(words, WORDS[mode]);
    cell.hidden = only.hidden = draft.hidden = mode === "update";
  };
  const pick = choices("How", level.current_map_id ? MODES : MODES.slice(1), mode, (value) => { mode = value; draw(); });
  const progress = h("div", {});
  draw();
  const start = async () => {
    const asked = mode === "update"
      ? { level_id: level.id, mode }
      : { level_id: level.id, mode, cell_m: valueOf(cell.input), publish: !draft.input.checked, survey_ids: only.input.checked ? [survey.id] : [] };
    const job = await follow(app, await app.api.post("/v1/maps", asked), progress);
    if (job.state !== "done") throw new ApiError(0, { title: "The map was not made", detail: job.error ?? `The job was ${job.state}.` });
    toast("The map is made.", { kind: "good" });
    close(job.result.map_id ?? null);
  };
  return form([pick, words, cell, only, draft, progress], start, { submit: "Start", cancel: () => close(null) });
}

async function follow(app, job, place) {
  const bar = h("progress", { max: 1, value: 0, "aria-label": "Progress of the map" });
  const text = h("p", { class: "small", role: "status" }, "Waiting…");
  replace(place, bar, text);
  return app.api.job(job.id, (now) => {
    bar.value = now.progress;
    replace(text, now.progress_text || now.state);
  });
}
