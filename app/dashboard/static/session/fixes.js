// The fixes of a session, in columns, as they come.

const CLAIMS = "ok";
const GAP_MS = 10_000;

/** Columns of fixes with the ways that a page looks at them; times are Unix milliseconds. */
export class FixLog {
  constructor() {
    this.columns = {
      t_ms: [], x: [], y: [], cov_xx: [], cov_xy: [], cov_yy: [], heading_deg: [], status: [], sure: [], quality: [], walk_on_m: [], level_id: [], hypotheses: [],
    };
    this.last = -1;
  }

  get length() { return this.columns.t_ms.length; }
  get start() { return this.columns.t_ms[0] ?? 0; }
  get end() { return this.columns.t_ms.at(-1) ?? 0; }

  /** Add a page of positions, or an event of the session's stream; what is known already is passed over. */
  append({ number, fixes }) {
    const from = number.findIndex((one) => one > this.last);
    if (from < 0) return;
    for (const [name, column] of Object.entries(this.columns)) {
      const values = fixes[name];
      for (let i = from; i < number.length; i += 1) column.push(values[i]);
    }
    this.last = number.at(-1);
  }

  /** Index of the last fix at or before a time; -1 before the first. */
  at(t) {
    const times = this.columns.t_ms;
    let [low, high] = [0, times.length];
    while (low < high) {
      const middle = (low + high) >> 1;
      if (times[middle] <= t) low = middle + 1;
      else high = middle;
    }
    return low - 1;
  }

  /** Where positions were claimed on a level, with so many metres around it; null: nowhere. */
  extent(levelId, margin) {
    const { x, y, level_id, status } = this.columns;
    const here = x.map((_, i) => i).filter((i) => level_id[i] === levelId && status[i] === CLAIMS);
    if (!here.length) return null;
    const [xs, ys] = [here.map((i) => x[i]), here.map((i) => y[i])];
    const least = (values) => values.reduce((a, b) => Math.min(a, b)) - margin;
    const most = (values) => values.reduce((a, b) => Math.max(a, b)) + margin;
    return { x_min: least(xs), x_max: most(xs), y_min: least(ys), y_max: most(ys) };
  }

  /** One fix as an object; null for -1. */
  fix(i) {
    return i < 0 ? null : Object.fromEntries(Object.entries(this.columns).map(([name, column]) => [name, column[i]]));
  }

  /** The hypotheses told last with or before fix i (they come with the last fix of a segment), while none is claimed. */
  hypotheses(i) {
    const { status, hypotheses } = this.columns;
    for (let k = i; k >= 0 && status[k] !== CLAIMS; k -= 1) if (hypotheses[k]?.length) return hypotheses[k];
    return [];
  }

  /**
   * Stretches of fixes up to `last` on a level that may be joined by a line: [from, to, name], ends included; where a
   * fix claims no position, or none was told for ten seconds, the line breaks.
   */
  stretches(levelId, last) {
    const { t_ms, level_id, status, sure } = this.columns;
    const found = [];
    for (let i = 0; i <= last; i += 1) {
      if (level_id[i] !== levelId) continue;
      const name = status[i] === CLAIMS ? (sure[i] ? "sure" : "ok") : status[i];
      const open = found.at(-1);
      const joins = open && open[1] === i - 1 && t_ms[i] - t_ms[i - 1] <= GAP_MS;
      if (joins && open[2] === name) open[1] = i;
      else found.push([joins && claims(name) && claims(open[2]) ? i - 1 : i, i, name]);
    }
    return found;
  }
}

function claims(name) { return name === "sure" || name === "ok"; }

/** Runs of one status: [from, to, status], ends included. */
export function statusRuns({ status, sure }) {
  const runs = [];
  status.forEach((name, i) => {
    const key = `${name}${sure[i] ? " sure" : ""}`;
    const open = runs.at(-1);
    if (open && open[2] === key) open[1] = i;
    else runs.push([i, i, key]);
  });
  return runs;
}

/** Read all positions of a session, a page at a time. */
export async function readAll(app, id, log, onpage = () => {}) {
  for await (const page of pagesOf(app, id)) {
    log.append(page);
    onpage(log);
  }
}

async function* pagesOf(app, id) {
  let cursor = null;
  do {
    const page = await app.api.get(`/v1/sessions/${id}/positions`, { limit: 500, cursor });
    yield page;
    cursor = page.next_cursor;
  } while (cursor !== null);
}
