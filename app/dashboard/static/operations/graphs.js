// Charts of the operations page: percentiles and rates over time.

import { chart } from "../charts.js";
import { choices, fixed, h, number, replace, table } from "../ui.js";
import { kindName } from "./words.js";

const PERCENTILES = [[50, "solid"], [90, "dash"], [95, "dashdot"], [99, "dot"]];
const SPANS = [["total", "Acceptance to result"], ["wait", "Waiting"], ["processing", "Processing"]];

/** Percentiles over time of one kind of job and one span, to choose; the figures as a table below. */
export function latencyCharts({ items, since, until }, context) {
  const kinds = [...new Set(items.map((row) => row.kind))];
  if (!kinds.length) return h("p", { class: "soft" }, "Nothing was processed.");
  const shown = { kind: kinds.includes("locate_segment") ? "locate_segment" : kinds[0], span: "total" };
  const figures = h("div", {});
  const range = [since, until];
  const graph = context.keep(chart({ label: "Percentiles of the time that jobs take", ...traces(items, shown, range), height: 280 }));
  const draw = () => {
    graph.update(traces(items, shown, range));
    replace(figures, figureTable(items.filter((row) => row.kind === shown.kind), shown.span));
  };
  draw();
  return [
    h(
      "div",
      { class: "row start" },
      choices("Jobs", kinds.map((kind) => [kind, kindName(kind)]), shown.kind, (kind) => { shown.kind = kind; draw(); }),
      choices("Time", SPANS, shown.span, (span) => { shown.span = span; draw(); }),
    ),
    graph.element,
    h("details", {}, h("summary", {}, "Figures"), figures),
  ];
}

function traces(items, { kind, span }, range) {
  const rows = items.filter((row) => row.kind === kind);
  const marks = decades(rows.flatMap((row) => PERCENTILES.map(([percent]) => row[`${span}_p${percent}_ms`])));
  return {
    traces: PERCENTILES.map(([percent, dash]) => ({
      x: rows.map((row) => row.since),
      y: rows.map((row) => row[`${span}_p${percent}_ms`]),
      name: `p${percent}`,
      mode: "lines+markers",
      line: { dash, width: 2 }, marker: { size: 5 },
      hovertemplate: `p${percent}: %{y:.3~s} ms<extra></extra>`,
    })),
    layout: {
      showlegend: true, hovermode: "x unified",
      yaxis: { title: { text: "time, ms" }, type: "log", tickvals: marks, ticktext: marks.map((value) => number(value)) },
      xaxis: { type: "date", range },
    },
  };
}

// 1, 2 and 5 of every power of ten that the values reach: the library writes those in between as bare digits.
function decades(values) {
  const positive = values.filter((value) => value > 0);
  if (!positive.length) return [1];
  const [low, high] = [Math.min(...positive), Math.max(...positive)];
  const marks = [];
  for (let power = Math.floor(Math.log10(low)); power <= Math.ceil(Math.log10(high)); power += 1) {
    marks.push(...[1, 2, 5].map((digit) => digit * 10 ** power));
  }
  return marks;
}

function figureTable(rows, span) {
  return table(
    [
      { head: "From", cell: (row) => moment(row.since) },
      { head: "Jobs", number: true, cell: (row) => number(row.n, 12) },
      ...PERCENTILES.map(([percent]) => ({ head: `p${percent}, ms`, number: true, cell: (row) => fixed(row[`${span}_p${percent}_ms`]) })),
    ],
    rows,
    { caption: "Latency" },
  );
}

/** Segments and fixes a second over time. */
export function throughputChart({ items: rows, since, until }, context) {
  const total = (name) => rows.reduce((sum, row) => sum + row[name], 0);
  const over = (name, words, look) => ({
    x: rows.map((row) => row.since), y: rows.map((row) => row[name]), name: words, hovertemplate: `%{y:.3~s} ${words}<extra></extra>`, ...look,
  });
  const graph = context.keep(chart({
    label: "Segments and fixes a second over time",
    traces: [
      over("fixes_per_s", "fixes/s", { type: "bar", marker: { opacity: 0.75 } }),
      over("segments_per_s", "segments/s", { yaxis: "y2", mode: "lines+markers", marker: { size: 4 } }),
    ],
    layout: {
      showlegend: true, hovermode: "x unified", bargap: 0.15, xaxis: { type: "date", range: [since, until] },
      yaxis: { title: { text: "fixes/s" }, rangemode: "tozero" },
      yaxis2: { title: { text: "segments/s" }, overlaying: "y", side: "right", tickmode: "auto", nticks: 5, rangemode: "tozero", showgrid: false, automargin: true },
      margin: { l: 48, r: 56, t: 12, b: 40 },
    },
  }));
  return [
    h("p", {}, `${number(total("segments"), 12)} segments, ${number(total("samples"), 12)} samples, ${number(total("fixes"), 12)} fixes; ${number(total("segments_failed"), 12)} segments failed.`),
    graph.element,
  ];
}

function moment(iso) {
  return new Intl.DateTimeFormat(undefined, { dateStyle: "short", timeStyle: "short" }).format(new Date(iso));
}
