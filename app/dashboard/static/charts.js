// Charts with Plotly, which is loaded when the first one is drawn, and follows light and dark.

import { h } from "./ui/element.js";
import { colour, onTheme } from "./theming.js";

let library = null;

// The library brings the style sheet of a street map, which no page here draws, and leaves it out where an element of
// this id stands already. (Another version may have another id: then a test of the charts fails.)
const STREET_MAP_STYLE = "9f215cf04c5486422605d13261cb87401f4e7763b6296af81e98efbc0130da53";

// Plotly writes styles as attributes here and there, which the page's policy forbids; set by script, as CSS
// declarations, the same styles are allowed, and no text of an answer can come in that way.
function styleByScript() {
  const plain = Element.prototype.setAttribute;
  Element.prototype.setAttribute = function setAttribute(name, value) {
    if (name === "style") this.style.cssText = value;
    else plain.call(this, name, value);
  };
}

function plotly() {
  library ??= new Promise((resolve, reject) => {
    styleByScript();
    document.head.append(h("meta", { id: STREET_MAP_STYLE }));
    const script = h("script", { src: "/vendor/plotly.min.js" });
    script.onload = () => resolve(window.Plotly);
    script.onerror = () => {
      library = null;
      reject(new Error("The chart library could not be loaded"));
    };
    document.head.append(script);
  });
  return library;
}

/** Colours of lines, in the order in which they are taken. */
export const LINES = ["accent", "second", "third", "fourth", "fifth"];

function themed(layout) {
  const axis = {
    gridcolor: colour("line"), zerolinecolor: colour("line"), linecolor: colour("line"), tickcolor: colour("line"), automargin: true,
  };
  return {
    font: { family: "system-ui, sans-serif", size: 12, color: colour("text") },
    paper_bgcolor: "rgba(0,0,0,0)",
    plot_bgcolor: "rgba(0,0,0,0)",
    colorway: LINES.map(colour),
    margin: { l: 48, r: 12, t: 12, b: 40 },
    showlegend: false,
    legend: { orientation: "h", y: 1.12 },
    hoverlabel: { bgcolor: colour("card"), bordercolor: colour("line"), font: { color: colour("text") } },
    ...layout,
    xaxis: { ...axis, ...layout.xaxis },
    yaxis: { ...axis, ...layout.yaxis },
  };
}

/**
 * Draw a chart.
 *
 * @param {object} options  label (for those who do not see it: say what it shows), traces and layout (Plotly's),
 *     height in pixels
 * @returns {{element, ready, update, destroy}}  put the element somewhere, then call `destroy` from the clean-up
 */
export function chart({ label, traces, layout = {}, height = 260 }) {
  const element = h("div", { class: "chart", role: "img", "aria-label": label, style: { height: `${height}px` } });
  const state = { traces, layout, gone: false };
  const draw = async () => {
    const Plotly = await plotly();
    if (state.gone) return;
    // no mode bar: it would write a style sheet of its own, which the page's policy forbids
    await Plotly.react(element, state.traces, themed(state.layout), { displayModeBar: false, responsive: false, displaylogo: false });
  };
  const size = new ResizeObserver(() => {
    if (element.isConnected && element.classList.contains("js-plotly-plot")) window.Plotly.Plots.resize(element);
  });
  size.observe(element);
  const untheme = onTheme(draw);
  return {
    element,
    ready: draw(),
    update(next) {
      Object.assign(state, next);
      return draw();
    },
    destroy() {
      state.gone = true;
      size.disconnect();
      untheme();
      if (element.classList.contains("js-plotly-plot")) window.Plotly.purge(element);
    },
  };
}
