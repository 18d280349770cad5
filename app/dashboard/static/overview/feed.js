// Where all open sessions are: kept up to date by events, told to the page a few times a second however many come.

const TELL_MS = 250;
const RATE_S = 10;
const UNKNOWN = { t_ms: null, x: null, y: null, status: null, sure: null, number: null };

/**
 * Follow `GET /v1/live`.
 *
 *     const feed = new LiveFeed(app.api, { onchange: (feed) => draw(feed.sessions) });
 *     feed.run();              // until the page is left
 */
export class LiveFeed {
  constructor(api, { onchange, onstate = () => {} }) {
    this.api = api;
    this.onchange = onchange;
    this.onstate = onstate;
    /** Sessions by id, as the service tells them, with `heard`: when (ms of this page's clock). */
    this.sessions = new Map();
    this.#counts = [];
  }

  #counts;
  #timer = 0;

  /** Positions told a second, over the last ten seconds. */
  get rate() {
    const from = performance.now() - RATE_S * 1000;
    while (this.#counts.length && this.#counts[0] < from) this.#counts.shift();
    return this.#counts.length / RATE_S;
  }

  /** Listen until the page is left. */
  async run() {
    try {
      await this.api.events("/v1/live", {
        snapshot: ({ sessions }) => this.#snapshot(sessions),
        fix: (session) => this.#fix(session),
        session: ({ id, status }) => this.#session(id, status),
      }, { onstate: this.onstate });
    } finally {
      clearTimeout(this.#timer);
    }
  }

  #snapshot(sessions) {
    this.sessions = new Map(sessions.map((one) => [one.session_id, { ...one, heard: null }]));
    this.#soon();
  }

  #fix(session) {
    this.#counts.push(performance.now());
    this.sessions.set(session.session_id, { ...session, heard: Date.now() });
    this.#soon();
  }

  async #session(id, status) {
    if (status === "closed") this.sessions.delete(id);
    else if (!this.sessions.has(id)) await this.#opened(id);
    this.#soon();
  }

  // The event names the session only; what it is has to be asked for, and by then it may have told a position.
  async #opened(id) {
    const session = await this.api.find(`/v1/sessions/${id}`);
    if (session === null || session.status === "closed" || this.sessions.has(id)) return;
    const { device_id, venue_id, level_id } = session;
    this.sessions.set(id, { session_id: id, device_id, venue_id, level_id, ...UNKNOWN, heard: null });
  }

  // Events come one by one, at times hundreds a second; nobody reads faster than this.
  #soon() {
    this.#timer ||= setTimeout(() => {
      this.#timer = 0;
      this.onchange(this);
    }, TELL_MS);
  }
}
