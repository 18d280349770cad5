// One session: live as its fixes come, and again as often as you like.

import { ellipse95, statusColour, STATUS_WORDS } from "../overview/marks.js";
import {
  aboutCard, calibrationCard, contributionsCard, downloadsCard, eventsCard, hypothesesList, listCard, truthCard,
} from "../session/cards.js";
import { FixLog, readAll } from "../session/fixes.js";
import { Player } from "../session/player.js";
import { ProfileCard } from "../session/profile.js";
import { SessionStage } from "../session/stage.js";
import { confirm, fixed, h, metres, problem, replace, shortId, toast, toastError } from "../ui.js";

export const title = (params) => `Session ${shortId(params.session_id)}`;

const LISTS_MS = 5000;
const BADGES = { accent: "good", warn: "warn", bad: "bad", fourth: "warn", soft: "" };

export async function render(root, params, app) {
  const session = await app.api.get(`/v1/sessions/${params.session_id}`);
  const [venue, device, levels] = await Promise.all([
    app.api.get(`/v1/venues/${session.venue_id}`),
    session.device_id && app.api.find(`/v1/devices/${session.device_id}`),
    app.api.all("/v1/levels", { venue_id: session.venue_id }),
  ]);
  const page = new SessionPage(app, session, { venue, device, levels });
  root.append(page.element);
  await page.begin();
  return () => page.destroy();
}

class SessionPage {
  constructor(app, session, { venue, device, levels }) {
    Object.assign(this, { app, session, venue, device });
    const names = new Map(levels.map((level) => [level.id, level.name]));
    this.log = new FixLog();
    this.stage = new SessionStage(app, session, this.log);
    this.player = new Player(this.log, { live: session.status === "open", onchange: (i) => this.#show(i) });
    this.profile = new ProfileCard(app, session);
    this.profile.onlearned = (profile) => replace(this.calibration, calibrationCard(this.session, profile));
    this.state = h("span", { class: "badge", role: "status" });
    this.reading = h("p", { class: "readout" });
    this.places = hypothesesList((id) => names.get(id) ?? id);
    this.calibration = h("div", {}, calibrationCard(session, null));
    [this.truth, this.events, this.contributions, this.trouble] = [h("div", {}), h("div", {}), h("div", {}), h("div", {})];
    this.head = h("div", { class: "row" });
    this.element = h(
      "div",
      { class: "stack session" },
      h("div", { class: "page-head" }, h("p", { class: "crumbs" }, h("a", { href: "#/sessions" }, "Sessions")), h("h1", {}, `Session ${shortId(session.id)}`), this.head),
      this.trouble,
      h(
        "div",
        { class: "level-columns" },
        h("div", { class: "stack" }, h("section", { class: "card", "aria-label": "Track" }, this.stage.element, this.reading, this.places.element, this.player.element), this.profile.element),
        h("div", { class: "stack" }, this.#about(), this.calibration, this.truth, this.events, this.contributions, downloadsCard(app, session, Boolean(venue.anchor))),
      ),
    );
    this.#drawHead();
  }

  #ended = new AbortController();
  #gone = false;
  #timer = 0;

  /** Draw what is there, then follow what comes. */
  async begin() {
    await readAll(this.app, this.session.id, this.log);
    if (!this.player.live) this.player.seek(this.log.end);
    this.#grown();
    if (!this.log.length) await this.stage.show(-1);
    this.#lists();
    if (this.session.status === "open") this.#follow().catch((error) => { if (error.name !== "AbortError") replace(this.trouble, problem(error)); });
  }

  destroy() {
    this.#gone = true;
    this.#ended.abort();
    clearTimeout(this.#timer);
    for (const part of [this.player, this.stage, this.profile]) part.destroy();
  }

  #about() {
    this.about = h("div", {}, aboutCard(this.session, this));
    return this.about;
  }

  #grown() {
    this.player.grown();
    this.profile.update();
  }

  #show(i) {
    const fix = this.log.fix(i);
    this.stage.following = this.player.following || this.player.playing;
    this.stage.show(i).catch(toastError);
    this.places.update(this.log.hypotheses(i));
    if (fix) this.profile.setNow(fix.t_ms);
    replace(this.reading, fix ? this.#words(fix) : "No position yet.");
  }

  #words(fix) {
    const badge = h("span", { class: `badge ${BADGES[statusColour(fix.status)]}`, title: STATUS_WORDS[fix.status] }, `${fix.status.replace("_", " ")}${fix.sure ? ", sure" : ""}`);
    const more = fix.walk_on_m ? ` · walk on about ${metres(fix.walk_on_m)}` : "";
    return [badge, " ", h("b", {}, `x ${fixed(fix.x)} m, y ${fixed(fix.y)} m`), ` ± ${metres(ellipse95(fix).major)} (95\u202f%) · heading ${fixed(fix.heading_deg, 0)}°${more}`];
  }

  // The stream ends by itself when the session is closed, and must not be opened once more then.
  #follow() {
    this.#setState("connecting", "warn");
    return this.app.api.events(`/v1/sessions/${this.session.id}/events`, {
      fixes: (page) => { this.log.append(page); this.#grown(); this.#listsSoon(); },
      session: (session) => this.#closed(session),
    }, {
      lastId: this.log.length ? this.log.last : null,
      signal: AbortSignal.any([this.app.signal, this.#ended.signal]),
      onstate: (now) => { if (this.session.status === "open") this.#setState(now === "open" ? "live" : "reconnecting", now === "open" ? "good" : "warn"); },
    });
  }

  #closed(session) {
    this.#ended.abort();
    if (this.#gone) return;
    this.session = Object.assign(this.session, session);
    this.player.ended();
    this.#drawHead();
    replace(this.about, aboutCard(this.session, this));
    this.profile.update();
    this.#lists();
  }

  #lists() {
    const { api, account } = this.app;
    const id = this.session.id;
    listCard(this.truth, () => api.all(`/v1/sessions/${id}/ground-truth`), (points) => {
      this.stage.setTruth(points);
      return truthCard(points);
    });
    listCard(this.events, async () => (await api.get("/v1/geofence-events", { session_id: id, limit: 100 })).items, eventsCard);
    if (this.session.contributes && account.may("survey")) {
      listCard(this.contributions, async () => [await api.all("/v1/contributions", { session_id: id }), this.session.status], ([items]) => contributionsCard(this.session, items));
    }
  }

  // Known positions and events come after the fixes that they belong to.
  #listsSoon() {
    this.#timer ||= setTimeout(() => { this.#timer = 0; this.#lists(); }, LISTS_MS);
  }

  #setState(words, kind) {
    this.state.className = `badge ${kind}`;
    this.state.textContent = words;
  }

  #drawHead() {
    const open = this.session.status === "open";
    this.#setState(open ? "open" : "closed", open ? "good" : "");
    replace(this.head, this.state, open && h("button", { type: "button", class: "danger", onclick: () => this.#close() }, "Close session"));
  }

  async #close() {
    if (!(await confirm("Close the session?", "It takes no more segments then; those it has are still processed.", { action: "Close", danger: true }))) return;
    try {
      const session = await this.app.api.post(`/v1/sessions/${this.session.id}/close`);
      toast("The session is closed.", { kind: "good" });
      // what is still in the queue comes with the stream, which ends with the session
      if (this.session.status === "open") { this.session = Object.assign(this.session, session); this.#drawHead(); }
    } catch (error) {
      toastError(error);
    }
  }
}
