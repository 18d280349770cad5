// What sessions and walks taught about a device, epoch by epoch of its platform's own calibration.

import { calibrationFacts } from "../session/cards.js";
import { ago, confirm, dateTime, h, icon, number, replace, toast, toastError } from "../ui.js";

const SOURCES = { device: "with what it remembers", model: "with what others of its model have in common", none: "as a new device" };

/** The card; forgetting asks first. */
export function calibrationsCard(app, device) {
  const body = h("div", { class: "stack" });
  const draw = (known) => {
    const start = known.next_session;
    replace(
      body,
      h("p", {}, "The next session starts ", h("b", {}, SOURCES[start.source]), start.epoch && ` (epoch ${start.epoch})`, "."),
      known.calibrations.length === 0 && start.calibration && calibrationFacts(start.calibration),
      known.calibrations.map(epoch),
      known.calibrations.length > 0 && h("div", { class: "actions" }, h("button", { type: "button", class: "danger", onclick: forget }, icon("trash"), "Forget")),
    );
  };
  const forget = async () => {
    const text = "All epochs are forgotten: the next session starts as with a new device. Sessions that are open keep what they started with.";
    if (!(await confirm(`Forget what is known about ${device.name}?`, text, { action: "Forget", danger: true }))) return;
    try {
      await app.api.delete(`/v1/devices/${device.id}/calibrations`);
      toast("It is forgotten.", { kind: "good" });
      draw(await app.api.get(`/v1/devices/${device.id}`));
    } catch (error) {
      toastError(error);
    }
  };
  draw(device);
  return h(
    "section",
    { class: "card", "aria-label": "Calibration" },
    h("h2", {}, "Calibration"),
    h("p", { class: "soft small" }, "What the device’s own iron adds to the field once it is levelled, and the stride of whoever carries it."),
    body,
  );
}

function epoch(one, _, { length }) {
  const alone = length === 1;
  const from = one.n_sessions ? `${number(one.n_sessions)} ${one.n_sessions === 1 ? "session" : "sessions"}` : "survey walks";
  return h(
    "div",
    { class: "epoch" },
    h("h3", {}, one.epoch ? `Epoch ${one.epoch}` : alone ? "Known so far" : "Without an epoch"),
    h("p", { class: "soft small" }, `From ${from}, `, h("time", { datetime: one.updated_at, title: dateTime(one.updated_at) }, ago(one.updated_at))),
    calibrationFacts(one),
  );
}
