// What a level is called, where it lies in height, how far it reaches; its vector plan.

import { dialog, form, h, toast } from "../../ui.js";

const EDGES = ["x_min", "y_min", "x_max", "y_max"];

/** Ask for changes of a level and send them; true if there were any. */
export function editLevel(app, level) {
  return dialog(`Edit ${level.name}`, (close) => [
    form(
      [
        { name: "name", label: "Name", required: true, maxlength: 200, value: level.name },
        { name: "ordinal", label: "Storey (0 is the ground floor)", type: "number", step: 1, required: true, value: level.ordinal },
        ...EDGES.map((edge) => ({ name: `extent.${edge}`, label: `${edge.replace("_", " ")}, m`, type: "number", required: true, half: true, value: level.extent[edge] })),
        { name: "vector", label: "Vector plan (GeoJSON in level metres)", type: "file", accept: ".geojson,.json,application/geo+json", hint: "Empty: it stays as it is. Walls keep trackers in, walkable areas tell where a survey has gaps." },
      ],
      async (values) => {
        await send(app, level, values);
        toast("The level was saved.", { kind: "good" });
        close(true);
      },
      { cancel: () => close(null) },
    ),
    h("p", { class: "soft small" }, "Walks and maps stay where they are. The plan picture is stretched with the extent."),
  ]);
}

async function send(app, level, { vector, ...values }) {
  await app.api.patch(`/v1/levels/${level.id}`, values);
  if (!vector) return;
  await app.api.fetch("PUT", `/v1/levels/${level.id}/plan.geojson`, { body: vector, headers: { "Content-Type": "application/geo+json" } });
}
