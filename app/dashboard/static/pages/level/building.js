// Building the next map version, or bringing the current one up to date: a job whose progress is shown.

import { dialog, form, h, icon, replace, toast } from "../../ui.js";

const FEATURES = [
  ["vector", "All three components (x, y, z)"],
  ["hv", "Horizontal and vertical"],
  ["total", "Total intensity only"],
];

/** The button, and the place where the progress of a build is shown. */
export function buildButton(app, level, current, onbuilt) {
  const place = h("div", { class: "build-progress", role: "status", "aria-live": "polite" });
  const button = h("button", { type: "button", class: "primary", onclick: () => order() }, icon("layers"), current ? "Update the map" : "Build the map");
  const order = async () => {
    const job = await dialog(current ? "Update the map" : "Build the map", (close) => orderForm(app, level, current, close));
    if (!job) return;
    button.disabled = true;
    try {
      await follow(app, job, place, onbuilt);
    } finally {
      button.disabled = false;
    }
  };
  resume(app, level, button, place, onbuilt);
  return { button, place };
}

// A build that was ordered before this page was opened is followed too.
async function resume(app, level, button, place, onbuilt) {
  for (const state of ["running", "queued"]) {
    const { items } = await app.api.get("/v1/jobs", { kind: "build_map", state, limit: 100 });
    const job = items.find((one) => one.subject.level_id === level.id);
    if (!job) continue;
    button.disabled = true;
    await follow(app, job, place, onbuilt);
    button.disabled = false;
    return;
  }
}

function orderForm(app, level, current, close) {
  const settings = [
    { name: "features", label: "What the map holds", type: "select", options: FEATURES, value: "vector" },
    { name: "cell_m", label: "Distance of nodes, m", type: "number", min: 0.1, max: 10, value: 0.5, required: true },
    { name: "mapped_m", label: "Mapped within so many metres of a sample", type: "number", min: 0.1, max: 20, value: 1.5, required: true },
    { name: "align", label: "Estimate offsets and label errors of each walk", type: "checkbox", value: true, hint: "Off for calibrated devices along lines that hardly cross." },
  ];
  const modes = [["update", "Add the walks that it lacks, take out those deleted"], ["build", "Build anew from all walks"]];
  const entry = form(
    [
      ...(current ? [{ name: "mode", label: "How", type: "select", options: modes, value: "update" }] : []),
      ...settings,
      { name: "publish", label: "Use it for new sessions once it is built", type: "checkbox", value: true },
    ],
    async (values) => close(await app.api.post("/v1/maps", bodyOf(level, values))),
    { submit: "Start", cancel: () => close(null) },
  );
  const mode = entry.fieldOf("mode");
  // an update keeps the settings of the map that it starts from
  const only = () => settings.forEach(({ name }) => { entry.fieldOf(name).hidden = mode?.input.value === "update"; });
  mode?.input.addEventListener("change", only);
  only();
  return entry;
}

function bodyOf(level, { mode = "build", publish, ...settings }) {
  return { level_id: level.id, mode, publish, ...(mode === "build" ? settings : {}) };
}

async function follow(app, job, place, onbuilt) {
  const bar = h("progress", { max: 1, value: 0, "aria-label": "Progress of the map" });
  const words = h("span", {}, "Waiting for a worker");
  const stop = h("button", { type: "button", class: "small", onclick: () => app.api.post(`/v1/jobs/${job.id}/cancel`) }, "Cancel");
  replace(place, bar, h("div", { class: "row" }, words, stop));
  const done = await app.api.job(job.id, (now) => {
    bar.value = now.progress;
    words.textContent = now.progress_text || (now.state === "queued" ? "Waiting for a worker" : "Building");
  });
  replace(place);
  if (done.state === "done") {
    toast("The map was built.", { kind: "good" });
    onbuilt(done);
  } else {
    toast(done.state === "cancelled" ? "The build was cancelled." : `The build failed: ${done.error}`, { kind: done.state === "failed" ? "error" : "info" });
  }
}
