// Charts of the operations page: percentiles and rates over time.

import { chart } from "../charts.js";
import { choices, fixed, h, number, replace, table } from "../ui.js";
import { kindName } from "./words.js";

const PERCENTILES = [[50, "solid"], [90, "dash"], [95, "dashdot"], [99, "dot"]];
const SPANS = [["total", "Acceptance to result"], ["wait", "Waiting"], ["processing", "Processing"]];

/** Percentiles over time of one kind of job and one span, to choose; the figures as a table below. */
export function latencyCharts({ items }, context) {
  const kinds = [...new Set(items.map((row) => row.kind))];
  if (!kinds.length) return h("p", { class: "soft" }, "Nothing was processed.");
  const shown = { kind: kinds.includes("locate_segment") ? "locate_segment" : kinds[0], span: "total" };
  const figures = h("div", {});
  const graph = context.keep(chart({ label: "Percentiles of the time that jobs take", ...traces(items, shown), height: 280 }));
  const draw = () => {
    graph.update(traces(items, shown));
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

function traces(items, { kind, span }) {
  const rows = items.filter((row) => row.kind === kind);
  return {
    traces: PERCENTILES.map(([percent, dash]) => ({
      x: rows.map((row) => row.since),
      y: rows.map((row) => row[`${span}_p${percent}_ms`]),
      name: `p${percent}`,
      mode: rows.length > 1 ? "lines" : "markers",
      line: { dash, width: 2 },
      hovertemplate: `p${percent}: %{y:.3~s} ms<extra></extra>`,
    })),
    layout: {
      showlegend: true, hovermode: "x unified",
      yaxis: { title: { text: "ms" }, type: "log", exponentformat: "none" },
      xaxis: { type: "date" },
    },
  };
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
export function throughputChart({ items }, context) {
  const rows = items;
  const total = (name) => rows.reduce((sum, row) => sum + row[name], 0);
  const line = (name, words, extra = {}) => ({
    x: rows.map((row) => row.since), y: rows.map((row) => row[name]), name: words, mode: rows.length > 1 ? "lines" : "markers",
    line: { shape: "hv", width: 2 }, hovertemplate: `%{y:.3~s} ${words}<extra></extra>`, ...extra,
  });
  const graph = context.keep(chart({
    label: "Segments and fixes a second over time",
    traces: [line("fixes_per_s", "fixes/s", { fill: "tozeroy" }), line("segments_per_s", "segments/s", { yaxis: "y2" })],
    layout: {
      showlegend: true, hovermode: "x unified", xaxis: { type: "date" },
      yaxis: { title: { text: "fixes/s" }, rangemode: "tozero" },
      yaxis2: { title: { text: "segments/s" }, overlaying: "y", side: "right", rangemode: "tozero", showgrid: false },
      margin: { l: 48, r: 48, t: 12, b: 40 },
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
