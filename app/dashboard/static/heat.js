// Rasters as colours: evenly stepped lightness, legends with units, values under the pointer.

import { h } from "./ui/element.js";
import { number } from "./ui/format.js";

const N = 256;

// OKLab to the cube roots of cone responses and from there to linear sRGB (B. Ottosson, 2020); the even colours are
// the ones that the service paints its PNG rasters with, so that both look the same.
function srgb(lightness, chroma, hueDeg) {
  const hue = (hueDeg * Math.PI) / 180;
  const [a, b] = [chroma * Math.cos(hue), chroma * Math.sin(hue)];
  const l = (lightness + 0.3963377774 * a + 0.2158037573 * b) ** 3;
  const m = (lightness - 0.1055613458 * a - 0.0638541728 * b) ** 3;
  const s = (lightness - 0.0894841775 * a - 1.291485548 * b) ** 3;
  return [
    4.0767416621 * l - 3.3077115913 * m + 0.2309699292 * s,
    -1.2684380046 * l + 2.6097574011 * m - 0.3413193965 * s,
    -0.0041960863 * l - 0.7034186147 * m + 1.707614701 * s,
  ].map((linear) => {
    const c = Math.min(1, Math.max(0, linear));
    return Math.round(255 * (c <= 0.0031308 ? 12.92 * c : 1.055 * c ** (1 / 2.4) - 0.055));
  });
}

function mix(u, ...stops) {
  const at = u * (stops.length - 1);
  const i = Math.min(stops.length - 2, Math.floor(at));
  return stops[i] + (stops[i + 1] - stops[i]) * (at - i);
}

function table(colourOf) {
  return Array.from({ length: N }, (_, i) => colourOf(i / (N - 1)));
}

/** Colour tables by what they are good for. */
export const TABLES = {
  /** More is lighter: blue over green to yellow. */
  even: table((u) => srgb(mix(u, 0.25, 0.95), mix(u, 0.1, 0.16, 0.15), mix(u, 285, 100))),
  /** Below and above a middle: blue, nearly white, red. */
  apart: table((u) => {
    const away = Math.abs(2 * u - 1);
    return srgb(0.96 - 0.46 * away, 0.02 + 0.17 * away, u < 0.5 ? 255 : 30);
  }),
  /** Good is green, poor is red by way of yellow; lightness falls evenly, so it reads in grey as well. */
  grade: table((u) => srgb(mix(u, 0.86, 0.78, 0.5), mix(u, 0.12, 0.15, 0.17), mix(u, 165, 85, 25))),
};

/** Least and largest value to show: percentiles of what is finite. */
export function colourRange(values, { percent = [1, 99], symmetric = false, least = 0 } = {}) {
  const step = Math.max(1, Math.floor(values.length / 40_000));
  const finite = [];
  for (let i = 0; i < values.length; i += step) if (Number.isFinite(values[i])) finite.push(values[i]);
  if (!finite.length) return { low: 0, high: 1 };
  const sorted = Float32Array.from(finite).sort();
  const at = (p) => sorted[Math.min(sorted.length - 1, Math.round((p / 100) * (sorted.length - 1)))];
  if (symmetric) {
    const top = Math.max(least, Math.abs(at(percent[0])), Math.abs(at(percent[1])));
    return { low: -top, high: top };
  }
  const [low, high] = percent.map(at);
  return { low, high: high > low ? high : low + 1 };
}

/**
 * A raster as a canvas of one pixel a node, its first row the highest y; NaN is clear.
 *
 * @param {{values: Float32Array, rows: number, columns: number}} raster
 * @param {{low: number, high: number, colours?: number[][]}} shown
 */
export function heatImage({ values, rows, columns }, { low, high, colours = TABLES.even }) {
  const canvas = document.createElement("canvas");
  canvas.width = columns;
  canvas.height = rows;
  const context = canvas.getContext("2d");
  const image = context.createImageData(columns, rows);
  const pixels = new Uint32Array(image.data.buffer);
  const words = Uint32Array.from(colours, ([r, g, b]) => 0xff000000 | (b << 16) | (g << 8) | r);
  const factor = (N - 1) / (high - low);
  for (let row = 0; row < rows; row += 1) {
    const from = row * columns;
    const to = (rows - 1 - row) * columns;
    for (let column = 0; column < columns; column += 1) {
      const value = values[from + column];
      if (Number.isFinite(value)) {
        const index = Math.round((value - low) * factor);
        pixels[to + column] = words[index < 0 ? 0 : index > N - 1 ? N - 1 : index];
      }
    }
  }
  context.putImageData(image, 0, 0);
  return canvas;
}

/** The rectangle that a raster's pixels cover: half a cell beyond its outer nodes. */
export function rasterExtent({ rows, columns, x0, y0, cell_m }) {
  const half = cell_m / 2;
  return {
    x_min: x0 - half, x_max: x0 + columns * cell_m - half, y_min: y0 - half, y_max: y0 + rows * cell_m - half,
  };
}

/** Value of the node nearest to a place; NaN outside and where there is none. */
export function valueAt({ values, rows, columns, x0, y0, cell_m }, { x, y }) {
  const column = Math.round((x - x0) / cell_m);
  const row = Math.round((y - y0) / cell_m);
  return column < 0 || row < 0 || column >= columns || row >= rows ? NaN : values[row * columns + column];
}

/** A few round values between two, to write at a legend or to draw contours at. */
export function roundSteps(low, high, count = 5) {
  const rough = (high - low) / count;
  if (!(rough > 0)) return [];
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((n) => n * power).find((n) => n >= rough * 0.75);
  const first = Math.ceil(low / step - 1e-9);
  const last = Math.floor(high / step + 1e-9);
  return Array.from({ length: Math.max(0, last - first + 1) }, (_, i) => (first + i) * step);
}

/** A bar of the colours with round values below it. */
export function legend({ label, unit, low, high, colours = TABLES.even }) {
  const bar = h("canvas", { width: N, height: 1, class: "legend-bar", "aria-hidden": "true" });
  const context = bar.getContext("2d");
  colours.forEach(([r, g, b], i) => {
    context.fillStyle = `rgb(${r},${g},${b})`;
    context.fillRect(i, 0, 1, 1);
  });
  const marks = roundSteps(low, high).map((value) => h(
    "span",
    { style: { left: `${(100 * (value - low)) / (high - low)}%` } },
    number(value),
  ));
  const words = `${label}${unit ? `, ${unit}` : ""}`;
  return h(
    "figure",
    { class: "legend", "aria-label": `Colours: ${words}, from ${number(low)} to ${number(high)}` },
    h("figcaption", {}, words),
    bar,
    h("div", { class: "legend-marks", "aria-hidden": "true" }, marks),
  );
}
