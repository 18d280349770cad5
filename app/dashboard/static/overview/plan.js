// The small plan: one level at a time, by default the busiest, with the sessions on it.

import { levelPlan } from "../plans.js";
import { h, replace, select } from "../ui.js";
import { sessionsLayer } from "./marks.js";

/**
 * @param {object} app
 * @param {Map<string, object>} levels  by id
 * @returns {{element, update(sessions), destroy()}}
 */
export function livePlan(app, levels) {
  const place = h("div", { class: "live-plan" });
  const choice = h("div", {});
  const element = h("div", { class: "stack" }, choice, place);
  const layer = sessionsLayer();
  const state = { level: null, view: null, chosen: null, names: "", gone: false };

  const show = async (id) => {
    if (state.level === id) return;
    state.level = id;
    const view = await levelPlan(app, levels.get(id), { label: `Sessions on ${levels.get(id).name}` });
    if (state.level !== id || state.gone) return view.destroy();
    state.view?.destroy();
    state.view = view;
    view.add(layer);
    replace(place, view.element);
    return undefined;
  };

  const offer = (busy) => {
    const options = busy.map(([id, n]) => [id, `${levels.get(id).name} (${n})`]);
    const names = JSON.stringify([options, state.level]);
    // a select that is open must not change under the reader's hand
    if (names === state.names || choice.contains(document.activeElement)) return;
    state.names = names;
    replace(choice, select("Level", options, state.level, (id) => {
      state.chosen = id;
      layer.sessions = [];
      show(id);
    }));
  };

  return {
    element,
    update(sessions) {
      const busy = busiest(sessions, levels);
      const wanted = state.chosen ?? (state.level && busy.some(([id]) => id === state.level) ? state.level : busy[0]?.[0]);
      if (wanted) show(wanted);
      layer.sessions = sessions.filter((one) => one.level_id === state.level);
      state.view?.redraw();
      if (busy.length) offer(withChosen(busy, state.level));
      element.hidden = state.level === null;
    },
    destroy() {
      state.gone = true;
      state.view?.destroy();
    },
  };
}

function busiest(sessions, levels) {
  const counts = new Map();
  for (const { level_id: id } of sessions) if (levels.has(id)) counts.set(id, (counts.get(id) ?? 0) + 1);
  return [...counts].sort(([a, n], [b, m]) => m - n || (a < b ? -1 : 1));
}

function withChosen(busy, id) {
  return id === null || busy.some(([one]) => one === id) ? busy : [...busy, [id, 0]];
}
