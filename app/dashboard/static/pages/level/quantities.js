// What of a map can be shown on the plan: where each raster comes from, its unit, its colours.

import { TABLES, colourRange } from "../../heat.js";

const CHANNELS = {
  vector: ["total", "h", "v", "x", "y", "z"],
  hv: ["total", "h", "v"],
  total: ["total"],
};
const CHANNEL_WORDS = { total: "Total", h: "Horizontal", v: "Vertical", x: "x", y: "y", z: "z" };

/** Components that a map can tell, with words. */
export function channelsOf(map) {
  return CHANNELS[map.features].map((name) => [name, CHANNEL_WORDS[name]]);
}

const field = (statistic) => (api, map, { channel }) => api.raster(`/v1/maps/${map.id}/field`, { channel, statistic });
const quality = (layer) => (api, map) => api.raster(`/v1/maps/${map.id}/quality/raster`, { layer });
const headed = (layer) => (api, map, { heading }) => api.raster(`/v1/maps/${map.id}/quality/raster`, { layer, heading_deg: heading });

/** Directions of travel, as the API names them: degrees counter-clockwise from +x. */
export const HEADINGS = [
  ["0", "→ 0°"], ["45", "↗ 45°"], ["90", "↑ 90°"], ["135", "↖ 135°"], ["180", "← 180°"], ["225", "↙ 225°"], ["270", "↓ 270°"], ["315", "↘ 315°"],
];

/** By name: words, unit, whether it has components or headings, how it is loaded, its colours and the range that they span. */
export const QUANTITIES = {
  mean: { words: "Field", unit: "µT", channels: true, load: field("mean"), range: (values) => colourRange(values) },
  sd: { words: "Uncertainty of the field", unit: "µT", channels: true, load: field("sd"), colours: TABLES.grade, range: fromZero },
  support: { words: "Distance to the nearest survey sample", unit: "m", load: field("support"), colours: TABLES.grade, range: () => ({ low: 0, high: 10 }) },
  mean_error: { words: "Expected position error", unit: "m", load: quality("mean_error"), colours: TABLES.grade, range: fromZero },
  worst_error: { words: "Expected error, worst heading", unit: "m", load: quality("worst_error"), colours: TABLES.grade, range: fromZero },
  along: { words: "Expected error along the way", unit: "m", headings: true, load: headed("along"), colours: TABLES.grade, range: fromZero },
  across: { words: "Expected error across the way", unit: "m", headings: true, load: headed("across"), colours: TABLES.grade, range: fromZero },
  coverage: { words: "Coverage of the walkable space", unit: "", load: quality("coverage"), colours: [...TABLES.grade].reverse(), range: () => ({ low: 0, high: 1 }), value: (v) => (v > 0.5 ? "mapped" : "walkable, not mapped") },
  conflict: { words: "Conflict between walks, variance over noise", unit: "", load: quality("conflict"), colours: TABLES.grade, range: fromZero },
  age: { words: "Age of the newest evidence", unit: "days", load: aged, colours: TABLES.grade, range: fromZero },
  sources: { words: "Number of walks", unit: "", load: quality("sources"), range: fromZero },
};

const DAY_MS = 86_400_000;

// The API tells how old evidence was when the map was made: versions never change. Here it is as of today.
async function aged(api, map, choice) {
  const raster = await quality("age")(api, map, choice);
  const since = (Date.now() - Date.parse(map.created_at)) / DAY_MS;
  return { ...raster, values: raster.values.map((days) => days + since) };
}

function fromZero(values) {
  return { low: 0, high: colourRange(values).high };
}

/** The words of a quantity and its component or heading. */
export function wordsOf(name, { channel, heading }) {
  const { words, channels, headings } = QUANTITIES[name];
  if (headings) return `${words}, heading ${heading}°`;
  return channels ? `${words}, ${CHANNEL_WORDS[channel].toLowerCase()}` : words;
}

/** Rasters of map versions: they never change, so each is asked for once. */
export class Rasters {
  #api;
  #known = new Map();

  constructor(api) {
    this.#api = api;
  }

  /** {raster, low, high, colours, unit, words} of a quantity of a map; `choice` is {channel, heading}. */
  get(map, name, choice) {
    const quantity = QUANTITIES[name];
    const key = `${map.id} ${name} ${quantity.channels ? choice.channel : ""} ${quantity.headings ? choice.heading : ""}`;
    if (!this.#known.has(key)) {
      const loading = this.#load(quantity, map, name, choice);
      this.#known.set(key, loading);
      loading.catch(() => this.#known.delete(key));
    }
    return this.#known.get(key);
  }

  async #load(quantity, map, name, choice) {
    const raster = await quantity.load(this.#api, map, choice);
    return {
      raster,
      ...quantity.range(raster.values),
      colours: quantity.colours ?? TABLES.even,
      unit: quantity.unit,
      words: wordsOf(name, choice),
      value: quantity.value,
    };
  }
}
