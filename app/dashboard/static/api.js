// The public API: the key in a header, problems as errors, pages, rasters, jobs, streams.

/** A problem of the API (RFC 9457), or a network that did not answer (status 0). */
export class ApiError extends Error {
  constructor(status, { type = "", title, detail, errors = [] } = {}) {
    super(detail ?? title ?? `The service answered ${status}`);
    this.name = "ApiError";
    this.status = status;
    this.slug = type.split("/").pop();
    this.title = title;
    this.detail = detail;
    /** What is wrong with which field, and the remedy: [{field, message, remedy}]. */
    this.errors = errors;
  }
}

const FINAL = new Set(["done", "failed", "cancelled"]);
const LONGEST_PAUSE_MS = 30_000;

/**
 * Calls of one page or of the whole dashboard.
 *
 * `signal` of a call or of `scoped` ends it when the page is left.
 */
export class Api {
  #secret;
  #onUnauthorized;
  #signal;

  constructor(secret, { onUnauthorized = () => {}, signal = null } = {}) {
    this.#secret = secret;
    this.#onUnauthorized = onUnauthorized;
    this.#signal = signal;
  }

  /** The same API whose calls end with this signal. */
  scoped(signal) {
    return new Api(this.#secret, { onUnauthorized: this.#onUnauthorized, signal });
  }

  /**
   * Call and return the Response; a problem is thrown as ApiError.
   *
   * @param {object} options  query (object; null and undefined are left out), json, body, headers, signal
   */
  async fetch(method, path, { query = {}, json, body, headers = {}, signal = this.#signal, cache } = {}) {
    const given = json === undefined ? headers : { "Content-Type": "application/json", ...headers };
    let response;
    try {
      response = await fetch(address(path, query), {
        method,
        headers: { ...given, ...(this.#secret && { "X-API-Key": this.#secret }) },
        body: json === undefined ? body : JSON.stringify(json),
        signal,
        cache,
      });
    } catch (error) {
      if (error.name === "AbortError") throw error;
      throw new ApiError(0, { title: "The service cannot be reached", detail: `${method} ${path}: no answer` });
    }
    if (!response.ok && response.status !== 304) throw await this.#problem(response);
    return response;
  }

  async #problem(response) {
    const isProblem = (response.headers.get("Content-Type") ?? "").includes("json");
    const error = new ApiError(response.status, isProblem ? await response.json() : {});
    if (response.status === 401) this.#onUnauthorized(error);
    return error;
  }

  async #json(method, path, options) {
    const response = await this.fetch(method, path, options);
    return response.status === 204 ? null : response.json();
  }

  get(path, query = {}, options = {}) { return this.#json("GET", path, { ...options, query }); }
  post(path, json = undefined, options = {}) { return this.#json("POST", path, { ...options, json }); }
  put(path, json, options = {}) { return this.#json("PUT", path, { ...options, json }); }
  patch(path, json, options = {}) { return this.#json("PATCH", path, { ...options, json }); }
  delete(path, options = {}) { return this.#json("DELETE", path, options); }

  /** The same as `get`; null where there is no such thing, no such call in this version, or none for this key. */
  async find(path, query = {}, options = {}) {
    try {
      return await this.get(path, query, options);
    } catch (error) {
      if ([403, 404, 405].includes(error.status)) return null;
      throw error;
    }
  }

  /** Pages of a list: {items, next_cursor}, one after the other. */
  async *pages(path, query = {}, options = {}) {
    let cursor = query.cursor ?? null;
    do {
      const page = await this.get(path, { ...query, cursor }, options);
      yield page;
      cursor = page.next_cursor;
    } while (cursor !== null);
  }

  /** All items of a list, at most `most` of them. */
  async all(path, query = {}, { most = 5000, ...options } = {}) {
    const items = [];
    for await (const page of this.pages(path, { limit: 500, ...query }, options)) {
      items.push(...page.items);
      if (items.length >= most) break;
    }
    return items.slice(0, most);
  }

  /** Bytes of a file as a Blob. */
  async blob(path, query = {}, options = {}) {
    return (await this.fetch("GET", path, { ...options, query })).blob();
  }

  /**
   * A raster in float32: {values: Float32Array (row by row from the lowest y, NaN: nothing), rows, columns, x0, y0,
   * cell_m}; node [r, c] lies at (x0 + c * cell_m, y0 + r * cell_m).
   */
  async raster(path, query = {}, options = {}) {
    const response = await this.fetch("GET", path, { ...options, query: { ...query, format: "f32" } });
    const buffer = await response.arrayBuffer();
    const head = (name) => Number(response.headers.get(`X-Isodyn-${name}`));
    return {
      values: floats(buffer),
      rows: head("Rows"),
      columns: head("Columns"),
      x0: head("X0"),
      y0: head("Y0"),
      cell_m: head("Cell-M"),
    };
  }

  /** Wait for a job; `onprogress` gets it each time it is looked at. */
  async job(id, onprogress = () => {}, { signal = this.#signal, every_ms = 400 } = {}) {
    for (;;) {
      const job = await this.get(`/v1/jobs/${id}`, {}, { signal });
      onprogress(job);
      if (FINAL.has(job.state)) return job;
      await pause(every_ms, signal);
    }
  }

  /**
   * Listen to server-sent events until the signal ends it. A lost connection is taken up again after the last event
   * that had an id, with longer and longer pauses; an answer that says the request itself is wrong is thrown.
   *
   * @param {string} path
   * @param {object} on  listeners by event name: (data, id) => void; data is parsed JSON
   * @param {object} options  query, signal, lastId, onstate ("open", "waiting")
   */
  async events(path, on, { query = {}, signal = this.#signal, lastId = null, onstate = () => {} } = {}) {
    let wait = 1000;
    const seen = { id: lastId, retry: null };
    while (!signal?.aborted) {
      try {
        const headers = { Accept: "text/event-stream", ...(seen.id !== null && { "Last-Event-ID": String(seen.id) }) };
        const response = await this.fetch("GET", path, { query, headers, signal, cache: "no-store" });
        onstate("open");
        wait = 1000;
        for await (const event of serverSentEvents(response.body)) {
          if (event.id !== null) seen.id = event.id;
          if (event.retry !== null) seen.retry = event.retry;
          if (event.data !== null) on[event.name]?.(JSON.parse(event.data), event.id);
        }
      } catch (error) {
        if (signal?.aborted || error.name === "AbortError") return;
        if (error instanceof ApiError && error.status >= 400 && error.status < 500 && error.status !== 429) throw error;
        if (!(error instanceof ApiError || error instanceof TypeError)) throw error;
      }
      onstate("waiting");
      await pause(seen.retry ?? wait, signal).catch(() => {});
      wait = Math.min(wait * 2, LONGEST_PAUSE_MS);
    }
  }
}

/** Events of a stream: {name, data, id, retry}; comments are skipped. */
export async function* serverSentEvents(stream) {
  let event = blank();
  for await (const line of lines(stream)) {
    if (line === "") {
      if (event.lines.length || event.id !== null || event.retry !== null) yield finished(event);
      event = blank();
    } else if (!line.startsWith(":")) {
      const colon = line.indexOf(":");
      const name = colon < 0 ? line : line.slice(0, colon);
      const value = colon < 0 ? "" : line.slice(colon + 1).replace(/^ /, "");
      if (name === "data") event.lines.push(value);
      else if (name === "event") event.name = value;
      else if (name === "id" && !value.includes("\0")) event.id = value;
      else if (name === "retry" && /^\d+$/.test(value)) event.retry = Number(value);
    }
  }
}

function blank() {
  return { name: "message", lines: [], id: null, retry: null };
}

function finished({ name, lines: data, id, retry }) {
  return { name, data: data.length ? data.join("\n") : null, id, retry };
}

async function* lines(stream) {
  const reader = stream.pipeThrough(new TextDecoderStream()).getReader();
  let rest = "";
  try {
    for (;;) {
      const { value, done } = await reader.read();
      if (done) return;
      // a CR at the end may be the first half of CR LF: it waits for what follows
      const parts = (rest + value).split(/\r\n|\n|\r(?!$)/);
      rest = parts.pop();
      yield* parts;
    }
  } finally {
    reader.cancel().catch(() => {});
  }
}

function address(path, query) {
  const pairs = Object.entries(query).filter(([, value]) => value !== null && value !== undefined && value !== "");
  const text = new URLSearchParams(pairs.map(([name, value]) => [name, String(value)])).toString();
  return text ? `${path}?${text}` : path;
}

function floats(buffer) {
  const little = new Uint8Array(new Uint16Array([1]).buffer)[0] === 1;
  if (little) return new Float32Array(buffer);
  const view = new DataView(buffer);
  return Float32Array.from({ length: buffer.byteLength / 4 }, (_, i) => view.getFloat32(4 * i, true));
}

/** Wait; an AbortError if the signal comes first. */
export function pause(milliseconds, signal = null) {
  return new Promise((resolve, reject) => {
    const left = () => {
      clearTimeout(timer);
      reject(new DOMException("left", "AbortError"));
    };
    const timer = setTimeout(() => {
      signal?.removeEventListener("abort", left);
      resolve();
    }, milliseconds);
    if (signal?.aborted) left();
    else signal?.addEventListener("abort", left, { once: true });
  });
}
