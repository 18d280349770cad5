// Named points of a level: shown, moved, added, saved.

import { h, icon, replace, toast, toastError } from "../../ui.js";
import { markerLayer } from "./overlays.js";

const GRAB_PX = 12;

/** The card of markers; null where this service has none. */
export async function markersCard(app, view, level) {
  const path = `/v1/levels/${level.id}/markers`;
  const answer = await app.api.find(path);
  if (answer === null) return null;
  return new Markers(app, view, path, answer).element;
}

class Markers {
  constructor(app, view, path, answer) {
    this.app = app;
    this.view = view;
    this.path = path;
    this.#take(answer);
    this.layer = view.add(markerLayer(this.markers));
    this.body = h("div", { class: "stack" });
    this.element = h("section", { class: "card", "aria-labelledby": "markers" }, h("h2", { id: "markers" }, "Markers"), this.body);
    this.#draw();
  }

  // The list may come bare or under a name; it goes back the way it came.
  #take(answer) {
    this.key = Array.isArray(answer) ? null : ("markers" in answer ? "markers" : "items");
    this.markers = (this.key === null ? answer : answer[this.key]).map((one) => ({ ...one }));
  }

  #draw() {
    const editing = this.layer.editing;
    const may = this.app.account.may("survey");
    replace(
      this.body,
      h("p", { class: "soft small" }, editing
        ? "Click on the plan to add a point (or Enter at the crosshair), drag one to move it."
        : "A mark made on a survey walk with one of these names is a waypoint at that place."),
      this.markers.length ? h("ul", { class: "markers" }, this.markers.map((one) => this.#row(one))) : h("p", { class: "soft" }, "No markers yet."),
      may && h(
        "div",
        { class: "actions" },
        editing && h("button", { type: "button", onclick: () => this.#leave() }, "Cancel"),
        editing
          ? h("button", { type: "button", class: "primary", onclick: () => this.#save() }, "Save markers")
          : h("button", { type: "button", onclick: () => this.#edit() }, icon("edit"), "Edit markers"),
      ),
    );
  }

  #row(marker) {
    if (!this.layer.editing) return h("li", {}, h("b", {}, marker.name), h("span", { class: "soft" }, `x ${marker.x.toFixed(1)}, y ${marker.y.toFixed(1)} m`));
    const coordinate = (axis) => h("input", {
      type: "number", step: 0.1, value: marker[axis].toFixed(1), "aria-label": `${axis} of ${marker.name}, m`,
      onchange: (event) => { marker[axis] = event.target.valueAsNumber || 0; this.view.redraw(); },
    });
    return h(
      "li",
      { class: "edit" },
      h("input", { type: "text", value: marker.name, maxlength: 200, "aria-label": "Name", oninput: (event) => { marker.name = event.target.value; this.view.redraw(); } }),
      coordinate("x"),
      coordinate("y"),
      h("button", { type: "button", class: "quiet small", "aria-label": `Delete ${marker.name}`, onclick: () => this.#change(this.markers.filter((one) => one !== marker)) }, icon("trash")),
    );
  }

  #change(markers) {
    this.markers = markers;
    this.layer.markers = markers;
    this.view.redraw();
    this.#draw();
  }

  #edit() {
    this.before = this.markers.map((one) => ({ ...one }));
    this.layer.editing = true;
    this.view.onpick = ({ x, y }) => {
      const names = new Set(this.markers.map((one) => one.name));
      let n = this.markers.length + 1;
      while (names.has(`P${n}`)) n += 1;
      this.#change([...this.markers, { name: `P${n}`, x, y }]);
      this.body.querySelector("li:last-child input")?.select();
    };
    this.view.ongrab = ({ x, y }) => {
      const near = this.markers.find((one) => Math.hypot(one.x - x, one.y - y) * this.view.scale < GRAB_PX);
      return near && {
        drag: (place) => { Object.assign(near, place); this.view.redraw(); },
        drop: () => this.#draw(),
      };
    };
    this.#change(this.markers);
  }

  #leave(markers = this.before) {
    this.layer.editing = false;
    this.view.onpick = null;
    this.view.ongrab = null;
    this.#change(markers);
  }

  async #save() {
    try {
      const answer = await this.app.api.put(this.path, this.key === null ? this.markers : { [this.key]: this.markers });
      if (answer) this.#take(answer);
      toast("The markers were saved.", { kind: "good" });
      this.#leave(this.markers);
    } catch (error) {
      toastError(error);
    }
  }
}
