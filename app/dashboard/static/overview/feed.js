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
    /** Sessions by id, as the service tells them. */
    this.sessions = new Map();
    this.#counts = [];
  }

  #counts;
  #begun = performance.now();
  #timer = 0;

  /** Positions told a second, over the last ten seconds or since the page was opened. */
  get rate() {
    const now = performance.now();
    while (this.#counts.length && this.#counts[0] < now - RATE_S * 1000) this.#counts.shift();
    const seconds = Math.min(RATE_S, (now - this.#begun) / 1000);
    return seconds < 1 ? 0 : this.#counts.length / seconds;
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
    this.sessions = new Map(sessions.map((one) => [one.session_id, one]));
    this.#soon();
  }

  #fix(session) {
    this.#counts.push(performance.now());
    this.sessions.set(session.session_id, session);
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
    this.sessions.set(id, { session_id: id, device_id, venue_id, level_id, ...UNKNOWN });
  }

  // Events come one by one, at times hundreds a second; nobody reads faster than this.
  #soon() {
    this.#timer ||= setTimeout(() => {
      this.#timer = 0;
      this.onchange(this);
    }, TELL_MS);
  }
}
