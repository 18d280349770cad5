// The small plan: one level at a time, by default the busiest, with the sessions on it.

import { levelPlan } from "../plans.js";
import { h, replace, select } from "../ui.js";
import { SessionsOverlay } from "./marks.js";

/**
 * @param {object} app
 * @param {Map<string, object>} levels  by id
 * @returns {{element, update(sessions), destroy()}}
 */
export function livePlan(app, levels) {
  const place = h("div", { class: "live-plan" });
  const choice = h("div", {});
  const element = h("div", { class: "stack" }, choice, place);
  const state = { level: null, view: null, overlay: null, sessions: [], chosen: null, names: "", gone: false };

  const end = () => { state.overlay?.destroy(); state.view?.destroy(); };

  const draw = () => {
    if (!state.overlay) return;
    state.overlay.sessions = state.sessions.filter((one) => one.level_id === state.level);
    state.overlay.redraw();
  };

  const show = async (id) => {
    if (state.level === id) return;
    state.level = id;
    const view = await levelPlan(app, levels.get(id), { label: `Sessions on ${levels.get(id).name}` });
    if (state.level !== id || state.gone) return view.destroy();
    end();
    state.view = view;
    state.overlay = new SessionsOverlay(view);
    replace(place, view.element);
    draw();
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
      show(id);
    }));
  };

  return {
    element,
    update(sessions) {
      const busy = busiest(sessions, levels);
      const wanted = state.chosen ?? (state.level && busy.some(([id]) => id === state.level) ? state.level : busy[0]?.[0]);
      if (wanted) show(wanted);
      state.sessions = sessions;
      draw();
      if (busy.length) offer(withChosen(busy, state.level));
      element.hidden = state.level === null;
    },
    destroy() {
      state.gone = true;
      end();
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
