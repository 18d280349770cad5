// Where to walk next: suggested lines, on the plan and as a list with reasons.

import { empty, h, metres, number, problem, replace } from "../../ui.js";
import { suggestionLayer } from "./overlays.js";

/** The card of suggestions for a map, {element, destroy}; they are computed when it is opened. */
export function planningCard(app, view, map, count = 8) {
  const place = h("div", {});
  let layer = null;
  const box = h("details", {}, h("summary", {}, h("h2", {}, "Walk here next")), place);
  box.addEventListener("toggle", async () => {
    if (layer) {
      layer.visible = box.open;
      view.redraw();
    } else if (box.open) {
      replace(place, h("p", { class: "loading" }, "Looking for what would teach the map most…"));
      try {
        const plan = await app.api.get(`/v1/maps/${map.id}/suggestions`, { count });
        layer = view.add(suggestionLayer(plan.suggestions));
        layer.visible = box.open;
        replace(place, list(view, layer, plan));
      } catch (error) {
        if (error.name !== "AbortError") replace(place, problem(error));
      }
    }
  });
  return {
    element: h("section", { class: "card" }, box),
    destroy: () => { if (layer) view.remove(layer); },
  };
}

function list(view, layer, { suggestions }) {
  if (!suggestions.length) return empty("Nothing to walk", "The survey leaves no gap that a line would fill.");
  const choose = (index) => {
    layer.chosen = index;
    view.redraw();
  };
  return h(
    "ol",
    { class: "suggestions" },
    suggestions.map((one, i) => h(
      "li",
      { onpointerenter: () => choose(i), onpointerleave: () => choose(null) },
      h(
        "button",
        {
          type: "button", class: "link", onfocus: () => choose(i), onblur: () => choose(null),
          onclick: () => { view.reveal((one.start[0] + one.end[0]) / 2, (one.start[1] + one.end[1]) / 2); },
        },
        `${metres(one.length_m)}: ${one.words}`,
      ),
      h("span", { class: "soft small" }, `from x ${number(one.start[0])}, y ${number(one.start[1])} to x ${number(one.end[0])}, y ${number(one.end[1])} m; worth ${number(one.gain_m2)} m² of new ground`),
    )),
  );
}
