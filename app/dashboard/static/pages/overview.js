// Overview: what goes on now, and whether anything needs attention.

import { pause } from "../api.js";
import { alarmList } from "../overview/alarms.js";
import { LiveFeed } from "../overview/feed.js";
import { liveList } from "../overview/list.js";
import { livePlan } from "../overview/plan.js";
import { spark } from "../overview/spark.js";
import { hrefOf } from "../routes.js";
import { ago, empty, figure, fixed, h, loading, metres, number, percent, problem, replace, table } from "../ui.js";

export const title = "Overview";

const OFTEN_MS = 10_000;
const SELDOM_MS = 60_000;
const TICK_MS = 1000;
const WEEK_MS = 7 * 86_400_000;

export async function render(root, params, app) {
  const cleanups = [];
  const levels = new Map((await app.api.all("/v1/levels")).map((level) => [level.id, level]));
  const figures = h("section", { class: "card overview-figures", "aria-label": "Figures" });
  root.append(h("div", { class: "page-head" }, h("h1", {}, "Overview")), figures);
  const tiles = figureTiles(figures, app);
  const grid = h("div", { class: "overview-grid" });
  root.append(grid);
  if (app.account.may("locate")) cleanups.push(await liveSection(grid, app, levels, tiles));
  const side = h("div", { class: "stack" });
  grid.append(side);
  if (app.account.may("admin")) watchService(side, app, tiles);
  if (app.account.may("survey")) recentSurveys(side, app, levels);
  return () => cleanups.forEach((one) => one());
}

// Figures: a place each, filled by whoever knows it.
function figureTiles(card, app) {
  const names = { live: "live sessions", rate: "updates/s now" };
  if (app.account.may("admin")) {
    Object.assign(names, { fixes: "fixes/s, last minute", queue: "segments waiting", inside: "of places in 95 % ellipses", error: "p90 error, 7 days" });
  }
  const tiles = Object.fromEntries(Object.entries(names).map(([key, name]) => [key, figure("–", name)]));
  const graph = h("div", {});
  const place = h("div", { class: "spark-place", hidden: true }, graph, h("p", { class: "soft small" }, "fixes/s, last hour"));
  card.append(h("div", { class: "figures" }, Object.values(tiles)), place);
  return {
    set(key, value) {
      const text = tiles[key]?.firstChild;
      if (text && text.textContent !== value) text.textContent = value;
    },
    draw(line) {
      place.hidden = false;
      replace(graph, line);
    },
  };
}

async function liveSection(grid, app, levels, tiles) {
  const devices = new Map((await app.api.all("/v1/devices", {}, { most: 1000 })).map((device) => [device.id, device.name]));
  const plan = livePlan(app, levels);
  const list = liveList(
    { level: (id) => levels.get(id)?.name ?? "–", device: (id) => (id ? devices.get(id) ?? id : "–") },
    (id) => hrefOf(`/sessions/${id}`),
  );
  const state = h("span", { class: "badge", role: "status" }, "connecting");
  const body = h("div", { class: "stack" }, loading());
  grid.append(h("section", { class: "card", "aria-label": "Live" }, h("header", {}, h("h2", {}, "Live"), state), body));
  let listed = -Infinity;
  const draw = (feed) => {
    const sessions = [...feed.sessions.values()].sort((a, b) => (a.session_id < b.session_id ? 1 : -1));
    tiles.set("live", number(sessions.length));
    tiles.set("rate", fixed(feed.rate));
    if (!sessions.length) return replace(body, empty("No session is open", "Open sessions appear here as soon as a device sends."));
    if (!body.contains(list.element)) {
      replace(body, plan.element, list.element);
      listed = -Infinity;
    }
    plan.update(sessions);
    // dots move as told, words change no faster than one can read them
    if (performance.now() - listed < TICK_MS * 0.9) return undefined;
    listed = performance.now();
    list.update(sessions);
    return undefined;
  };
  const feed = new LiveFeed(app.api, {
    onchange: draw,
    onstate: (now) => replace(Object.assign(state, { className: `badge ${now === "open" ? "good" : "warn"}` }), now === "open" ? "live" : "reconnecting"),
  });
  feed.run().catch((error) => { if (error.name !== "AbortError") replace(body, problem(error)); });
  const tick = setInterval(() => { if (feed.sessions.size) draw(feed); }, TICK_MS);
  return () => { clearInterval(tick); plan.destroy(); };
}

// What only operators see: rates, queue, error budget, alarms.
function watchService(side, app, tiles) {
  const alarms = h("div", {}, loading());
  side.append(h("section", { class: "card", "aria-label": "Alarms" }, h("header", {}, h("h2", {}, "Alarms"), h("a", { href: "#/operations" }, "Operations")), alarms));
  repeat(app, OFTEN_MS, async () => {
    const [traffic, backlog] = await Promise.all([
      app.api.get("/v1/stats/throughput", { bucket: "minute" }),
      app.api.get("/v1/stats/backlog"),
    ]);
    const rates = traffic.items.map((row) => row.fixes_per_s);
    // the minute that has just begun says nothing yet
    tiles.set("fixes", fixed(rates.at(-2) ?? 0));
    tiles.set("queue", number(backlog.items.find((row) => row.kind === "locate_segment").queued));
    tiles.draw(spark(rates.slice(0, -1), "Fixes a second over the last hour"));
  });
  repeat(app, SELDOM_MS, async () => {
    replace(alarms, alarmList((await app.api.get("/v1/stats/alarms")).items, hrefOf));
  }, alarms);
  repeat(app, SELDOM_MS, async () => {
    const since = new Date(Date.now() - WEEK_MS).toISOString();
    const budget = (await app.api.get("/v1/stats/accuracy", { since })).items.find((row) => row.fixes === "sure");
    tiles.set("inside", budget ? percent(budget.inside_share) : "–");
    tiles.set("error", budget ? metres(budget.p90_m) : "–");
  });
}

function recentSurveys(side, app, levels) {
  const place = h("div", {}, loading());
  side.append(h("section", { class: "card", "aria-label": "Recent surveys" }, h("h2", {}, "Recent surveys"), place));
  repeat(app, SELDOM_MS, async () => {
    const { items } = await app.api.get("/v1/surveys", { limit: 5 });
    if (!items.length) return replace(place, h("p", { class: "soft" }, "No surveys yet."));
    return replace(place, table(
      [
        { head: "Survey", cell: (one) => h("a", { href: `#/surveys/${one.id}` }, one.name) },
        { head: "Level", cell: (one) => h("a", { href: `#/levels/${one.level_id}` }, levels.get(one.level_id)?.name ?? one.level_id) },
        { head: "Walks", cell: (one) => number(one.n_walks), number: true },
        { head: "Begun", cell: (one) => ago(one.created_at) },
      ],
      items,
      { caption: "Recent surveys" },
    ));
  }, place);
}

// Do something now and again until the page is left; trouble is shown in its place, and tried again.
async function repeat(app, every_ms, work, place = null) {
  while (!app.signal.aborted) {
    try {
      await work();
    } catch (error) {
      if (error.name === "AbortError") return;
      if (error.name !== "ApiError") throw error;
      if (place) replace(place, problem(error));
    }
    await pause(every_ms, app.signal).catch(() => {});
  }
}
