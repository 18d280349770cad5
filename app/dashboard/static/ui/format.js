// Numbers, units, times: one way to write each, everywhere.

const NONE = "–";
const made = new Map();

// Making a formatter takes longer than using it a hundred times, and live lists use it hundreds of times a second.
function formatter(Kind, options) {
  const key = `${Kind.name} ${JSON.stringify(options)}`;
  if (!made.has(key)) made.set(key, new Kind(undefined, options));
  return made.get(key);
}

/** A number with so many significant digits, in the reader's language; an en dash for what is not there. */
export function number(value, digits = 3) {
  if (value === null || value === undefined || !Number.isFinite(value)) return NONE;
  const options = Math.abs(value) >= 10 ** (digits - 1)
    ? { maximumFractionDigits: 0 }
    : { maximumSignificantDigits: digits };
  return formatter(Intl.NumberFormat, options).format(value);
}

/** A number with a fixed count of decimals: for columns that are compared. */
export function fixed(value, decimals = 1) {
  if (value === null || value === undefined || !Number.isFinite(value)) return NONE;
  return formatter(Intl.NumberFormat, {
    minimumFractionDigits: decimals,
    maximumFractionDigits: decimals,
  }).format(value);
}

/** A number and its unit, with a narrow space that does not break. */
export function unit(value, name, digits = 3) {
  const text = number(value, digits);
  return text === NONE ? text : `${text}\u202f${name}`;
}

/** A share as per cent. */
export function percent(share, decimals = 0) {
  return share === null || share === undefined || !Number.isFinite(share)
    ? NONE
    : `${fixed(share * 100, decimals)}\u202f%`;
}

/** A length in metres or kilometres. */
export function metres(value) {
  return Math.abs(value) >= 10_000 ? unit(value / 1000, "km") : unit(value, "m");
}

/** Bytes in the largest unit that keeps the number above one. */
export function bytes(value) {
  const names = ["B", "kB", "MB", "GB", "TB"];
  const power = Math.min(names.length - 1, Math.max(0, Math.floor(Math.log10(Math.max(value, 1)) / 3)));
  return unit(value / 1000 ** power, names[power]);
}

/** Seconds as people say them: 4.2 s, 3 min 20 s, 2 h 5 min. */
export function duration(seconds) {
  if (!Number.isFinite(seconds)) return NONE;
  if (seconds < 59.5) return unit(seconds, "s", 2);
  const whole = Math.round(seconds);
  const minutes = Math.floor(whole / 60);
  if (minutes < 60) return `${minutes}\u202fmin ${whole % 60}\u202fs`;
  return `${Math.floor(minutes / 60)}\u202fh ${minutes % 60}\u202fmin`;
}

/** Day and time of an ISO text or of Unix milliseconds, in the reader's zone. */
export function dateTime(value) {
  if (value === null || value === undefined) return NONE;
  return formatter(Intl.DateTimeFormat, { dateStyle: "medium", timeStyle: "short" }).format(new Date(value));
}

/** Day and time with seconds: where several things happen in a minute. */
export function moment(value) {
  if (value === null || value === undefined) return NONE;
  return formatter(Intl.DateTimeFormat, { dateStyle: "medium", timeStyle: "medium" }).format(new Date(value));
}

/** Time of day with seconds. */
export function timeOfDay(value) {
  if (value === null || value === undefined) return NONE;
  return formatter(Intl.DateTimeFormat, { timeStyle: "medium" }).format(new Date(value));
}

const AGES = [
  [60, "second", 1],
  [3600, "minute", 60],
  [86_400, "hour", 3600],
  [2_592_000, "day", 86_400],
  [31_536_000, "month", 2_592_000],
  [Infinity, "year", 31_536_000],
];

/** How long ago, in words; "short" ones where there is little room. */
export function ago(value, style = "long", now = Date.now()) {
  if (value === null || value === undefined) return NONE;
  const seconds = (now - new Date(value).getTime()) / 1000;
  const [, name, size] = AGES.find(([limit]) => Math.abs(seconds) < limit);
  return formatter(Intl.RelativeTimeFormat, { numeric: "auto", style }).format(-Math.round(seconds / size), name);
}

/** The end of an id, enough to tell it from its neighbours. */
export function shortId(id) {
  return id ? `${id.slice(0, 4)}…${id.slice(-6)}` : NONE;
}
