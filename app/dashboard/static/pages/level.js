// One level: its plan, its map, and everything that is done to them.

import { facts, figure, fill, h, icon, percent, replace, toggle, unit } from "../ui.js";
import { levelPlan } from "../plans.js";
import { buildButton } from "./level/building.js";
import { Comparison } from "./level/compare.js";
import { editLevel } from "./level/editing.js";
import { markersCard } from "./level/markers.js";
import { geofenceLayer, walkLayer } from "./level/overlays.js";
import { placePlan } from "./level/placing.js";
import { planningCard } from "./level/planning.js";
import { Stage } from "./level/stage.js";
import { versionsCard } from "./level/versions.js";

export const title = "Level";

export async function render(root, params, app) {
  const level = await app.api.get(`/v1/levels/${params.level_id}`);
  const [venue, maps, view] = await Promise.all([
    app.api.get(`/v1/venues/${level.venue_id}`),
    versionsOf(app, level),
    levelPlan(app, level),
  ]);
  app.setTitle(`${level.name}, ${venue.name}`);
  const page = new LevelPage(app, { level, venue, view, ...maps });
  root.append(page.element);
  page.begin();
  return () => view.destroy();
}

const VERSIONS = 20;

/** The newest versions, the current one among them however old it is, and where the older ones go on. */
async function versionsOf(app, level) {
  const query = { level_id: level.id, limit: VERSIONS };
  const { items: maps, next_cursor: cursor } = await app.api.get("/v1/maps", query);
  for (const id of [level.current_map_id, app.query.get("map")]) {
    if (id && !maps.some((map) => map.id === id)) maps.push(await app.api.get(`/v1/maps/${id}`));
  }
  return { maps: maps.filter((map) => map.level_id === level.id), cursor };
}

class LevelPage {
  constructor(app, { level, venue, maps, cursor, view }) {
    Object.assign(this, { app, level, venue, maps, cursor, view });
    this.may = app.account.may("survey");
    this.current = maps.find((map) => map.id === level.current_map_id) ?? null;
    this.viewed = maps.find((map) => map.id === app.query.get("map")) ?? this.current ?? maps[0] ?? null;
    this.stage = new Stage(app, view);
    this.compare = new Comparison(app, this.stage, maps, () => {});
    this.summary = h("div", { class: "stack" });
    this.layers = h("div", { class: "row start layers", role: "group", "aria-label": "Layers" });
    this.versions = h("div", {});
    this.planning = h("div", {});
    this.markers = h("div", {});
    this.element = h(
      "div",
      { class: "stack level" },
      this.#head(),
      h(
        "div",
        { class: "level-columns" },
        h("section", { class: "stack", "aria-label": "Plan" }, this.layers, this.stage.element, this.compare.element),
        h("div", { class: "stack" }, this.#about(), this.planning, this.versions, this.markers),
      ),
    );
  }

  /** Draw what needs no answer more, then ask for the rest. */
  begin() {
    this.#layers();
    this.#show(this.viewed);
    fill(this.markers, () => markersCard(this.app, this.view, this.level));
    this.#fences();
  }

  #head() {
    const build = this.may && buildButton(this.app, this.level, this.current, () => this.app.reload());
    return h(
      "div",
      { class: "stack" },
      h(
        "div",
        { class: "page-head" },
        h("p", { class: "crumbs" }, h("a", { href: "#/venues" }, "Venues"), " / ", h("a", { href: `#/venues/${this.venue.id}` }, this.venue.name)),
        h("h1", {}, this.level.name),
        this.may && h(
          "div",
          { class: "row" },
          h("button", { type: "button", onclick: () => this.#change(editLevel) }, icon("edit"), "Edit"),
          h("button", { type: "button", onclick: () => this.#change(placePlan) }, icon("upload"), "Plan picture"),
          build.button,
        ),
      ),
      build && build.place,
    );
  }

  #about() {
    return h("section", { class: "card", "aria-label": "The map in numbers" }, this.summary);
  }

  async #change(ask) {
    if (await ask(this.app, this.level)) this.app.reload();
  }

  #show(map) {
    this.viewed = map;
    if (map && map !== this.current) this.app.setQuery({ map: map.id });
    else this.app.setQuery({ map: null });
    this.stage.setMap(map);
    this.#numbers(map);
    this.planned?.destroy();
    this.planned = map && planningCard(this.app, this.view, map);
    replace(this.planning, this.planned?.element);
    this.#versions();
  }

  #versions() {
    replace(this.versions, this.maps.length > 0 && versionsCard(this.app, {
      level: this.level,
      maps: this.maps,
      viewed: this.viewed?.id,
      onmore: this.cursor && (() => this.#older()),
      onview: (one) => { if (!this.compare.element.hidden) this.compare.close(); this.#show(one); },
      oncompare: (one) => this.compare.open(one, this.current),
      onpublished: () => this.app.reload(),
    }));
  }

  async #older() {
    const query = { level_id: this.level.id, limit: VERSIONS, cursor: this.cursor };
    const { items, next_cursor: cursor } = await this.app.api.get("/v1/maps", query);
    this.cursor = cursor;
    this.maps.push(...items.filter((one) => !this.maps.some((map) => map.id === one.id)));
    this.maps.sort((a, b) => b.version - a.version);
    this.#versions();
  }

  #numbers(map) {
    if (!map) {
      replace(this.summary, h("p", { class: "soft" }, "There is no map yet. Upload survey walks, then build it."));
      return;
    }
    const own = h("div", { class: "figures" },
      figure(map.version, map === this.current ? "version, current" : "version, not current"),
      figure(map.n_walks, "survey walks"),
      figure(unit(map.mapped_area_m2, "m²"), "mapped"));
    const quality = h("div", { class: "stack" });
    replace(this.summary, own, quality);
    fill(quality, async () => {
      const found = await this.app.api.get(`/v1/maps/${map.id}/quality`);
      return facts([
        [found.coverage.by_plan ? "Of the walkable space" : "Of the ground around", percent(found.coverage.mapped_share)],
        ["Expected error, typical", unit(found.mean_error.p50_m, "m", 2)],
        ["Expected error, 90 %", unit(found.mean_error.p90_m, "m", 2)],
        ["Cells where walks disagree", found.conflict && `${found.conflict.conflict_cells} of ${found.conflict.shared_cells}`],
        ["Node distance", unit(map.cell_m, "m")],
        ["Repeatability: east, north, up", map.noise_sd.map((value) => value.toFixed(1)).join(", ") + " µT"],
      ]);
    });
  }

  #layers() {
    const of = (name, layer) => layer && toggle(name, layer.visible, (on) => { layer.visible = on; this.view.redraw(); });
    replace(this.layers, of("Plan picture", this.view.picture), of("Vector plan", this.view.vector), this.may && this.#walks());
  }

  #walks() {
    let layer = null;
    return toggle("Survey walks", false, async (on) => {
      if (!layer && on) layer = this.view.add(walkLayer(await this.app.api.all(`/v1/levels/${this.level.id}/waypoints`)));
      if (layer) layer.visible = on;
      this.view.redraw();
    });
  }

  async #fences() {
    const found = await this.app.api.find("/v1/geofences", { level_id: this.level.id });
    const fences = found?.items ?? [];
    if (!fences.length) return;
    const layer = this.view.add(geofenceLayer(fences));
    this.layers.append(toggle("Geofences", true, (on) => { layer.visible = on; this.view.redraw(); }));
  }
}
