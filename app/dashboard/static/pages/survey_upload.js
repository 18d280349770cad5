// Recordings into a survey: dropped or chosen, checked or stored, each with an account of what was made of it.

import { bytes, duration, h, icon, problem, replace, select, table, toggle, uniqueId } from "../ui.js";
import { ApiError } from "../api.js";

const FORMATS = [
  ["", "By its name"], ["walk", "Walk as the API takes it"], ["archive", "Survey archive (.zip)"],
  ["csv", "CSV, a row a sample"], ["getsensordata", "GetSensorData log"], ["sensor-logger", "Sensor Logger export"], ["phyphox", "phyphox export"],
];
const BY_SUFFIX = { json: "walk", msgpack: "walk", zip: "archive", csv: "csv", tsv: "csv", txt: "getsensordata", log: "getsensordata" };
const UNITS = [["", "As the file says"], ["uT", "µT"], ["nT", "nT"], ["mT", "mT"], ["gauss", "gauss"]];
const FATES = { new: ["good", "stored"], known: ["", "there already"], refused: ["bad", "refused"] };

/**
 * The card.
 *
 * @param {object} options  done (called when something was stored), preview (called with the walks of a check)
 */
export function uploadCard(app, survey, { done, preview }) {
  const how = { format: "", unit: "", dry: false };
  const reports = h("div", { class: "stack", role: "status" });
  const bar = h("progress", { max: 1, value: 0, hidden: true, "aria-label": "Files sent" });
  const take = async (files) => {
    bar.hidden = false;
    bar.max = files.length;
    bar.value = 0;
    const tried = [];
    for (const file of files) {
      const place = h("article", { class: "report" });
      reports.prepend(place);
      tried.push(...await send(app, survey, file, how, place));
      bar.value += 1;
    }
    bar.hidden = true;
    preview(how.dry ? tried : []);
    if (!how.dry) await done();
  };
  return h(
    "section",
    { class: "card" },
    h("header", {}, h("h2", {}, "Add recordings"), toggle("Check only, store nothing", false, (on) => { how.dry = on; })),
    dropZone(take),
    h(
      "div",
      { class: "row start" },
      select("Format", FORMATS, "", (value) => { how.format = value; }),
      select("Unit of the magnetometer, CSV", UNITS, "", (value) => { how.unit = value; }),
    ),
    bar,
    reports,
  );
}

function dropZone(take) {
  const id = uniqueId("files");
  const input = h("input", { type: "file", id, multiple: true, class: "visually-hidden", onchange: async () => {
    const files = [...input.files];
    input.value = "";
    await take(files);
  } });
  const over = (event, on) => {
    event.preventDefault();
    zone.classList.toggle("over", on);
  };
  const zone = h(
    "label",
    {
      class: "drop", for: id,
      ondragenter: (event) => over(event, true), ondragover: (event) => over(event, true), ondragleave: (event) => over(event, false),
      ondrop: (event) => {
        over(event, false);
        take([...event.dataTransfer.files]);
      },
    },
    icon("upload"),
    h("span", {}, h("b", {}, "Drop recordings here"), " or choose files"),
    h("small", { class: "soft" }, "Walks (.json, .msgpack), archives (.zip), CSV, GetSensorData logs (.txt); exports of Sensor Logger and phyphox: choose the format"),
  );
  return h("div", { class: "drop-box" }, input, zone);
}

/** Send one file; gives the walks found in it, for a preview. */
async function send(app, survey, file, how, place) {
  const kind = how.format || BY_SUFFIX[file.name.split(".").pop().toLowerCase()];
  const head = h("header", { class: "row" }, h("h3", {}, file.name), h("span", { class: "soft" }, bytes(file.size)));
  replace(place, head, h("p", { class: "loading" }, "Sending…"));
  try {
    if (!kind) throw new ApiError(0, { title: "Unknown kind of file", detail: `${file.name} does not tell its format: choose one above.` });
    const report = kind === "walk" ? await sendWalk(app, survey, file, how) : await importFile(app, survey, file, kind, how);
    replace(place, head, ...account(report));
    return report.walks.filter((walk) => walk.fate !== "refused");
  } catch (error) {
    replace(place, head, problem(error));
    return [];
  }
}

async function importFile(app, survey, file, kind, how) {
  const query = { format: kind, name: file.name.replace(/\.[^.]*$/, ""), dry_run: how.dry || null, unit: how.unit && kind === "csv" ? `mag=${how.unit}` : null };
  const small = await zipped(file);
  const response = await app.api.fetch("POST", `/v1/surveys/${survey.id}/import`, { query, ...small });
  return response.json();
}

async function sendWalk(app, survey, file, how) {
  if (how.dry) throw new ApiError(0, { title: "A walk cannot be checked only", detail: "Walks as the API takes them are checked when they are stored; nothing is stored if they do not fit." });
  const type = file.name.toLowerCase().endsWith(".json") ? "application/json" : "application/msgpack";
  const response = await app.api.fetch("POST", `/v1/surveys/${survey.id}/walks`, { body: file, headers: { "Content-Type": type } });
  const walk = await response.json();
  return { walks: [{ ...walk, reasons: [], fate: response.status === 200 ? "known" : "new" }], dry_run: false, read: [], assumed: [], skipped: [] };
}

/** Body and headers of a file: text is sent compressed, the service's bound is on what is sent. */
async function zipped(file) {
  const headers = { "Content-Type": "application/octet-stream" };
  if (file.name.toLowerCase().endsWith(".zip")) return { body: file, headers };
  const packed = file.stream().pipeThrough(new CompressionStream("gzip"));
  return { body: await new Response(packed).blob(), headers: { ...headers, "Content-Encoding": "gzip" } };
}

function account(report) {
  const [stored, refused] = [report.walks.filter((one) => one.fate === "new").length, report.walks.filter((one) => one.fate === "refused").length];
  const words = `${report.walks.length} walks read, ${stored} ${report.dry_run ? "would be stored" : "stored"}${refused ? `, ${refused} refused` : ""}.`;
  return [
    h("p", {}, words),
    report.walks.length > 0 && fates(report),
    notes("Taken for", report.assumed),
    notes("Left out", report.skipped),
  ].filter(Boolean);
}

function fates(report) {
  return table(
    [
      { head: "Walk", cell: (walk) => walk.name },
      { head: "", cell: (walk) => fateBadge(walk, report.dry_run) },
      { head: "Samples", number: true, cell: (walk) => walk.n_samples },
      { head: "Positions", number: true, cell: (walk) => walk.n_waypoints },
      { head: "Time", number: true, cell: (walk) => duration(walk.duration_s) },
      { head: "Why", cell: (walk) => walk.reasons.join("; ") },
    ],
    report.walks,
    { caption: "Walks of the file" },
  );
}

function fateBadge(walk, dry) {
  const [kind, words] = FATES[walk.fate];
  return h("span", { class: `badge ${kind}` }, dry && walk.fate === "new" ? "can be stored" : words);
}

function notes(title, lines) {
  return lines.length > 0 && h("details", { open: lines.length < 6 }, h("summary", {}, `${title} (${lines.length})`), h("ul", { class: "notes" }, lines.map((line) => h("li", {}, line))));
}
