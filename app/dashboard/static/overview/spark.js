// A line without axes, for how something went lately.

import { h } from "../ui.js";

const WIDTH = 240;
const HEIGHT = 44;

/** Values in order of time; `label` says what they are to those who do not see it. */
export function spark(values, label) {
  const most = Math.max(...values, 1e-9);
  const points = values.map((value, i) => {
    const x = (WIDTH * i) / Math.max(values.length - 1, 1);
    return `${x.toFixed(1)} ${(HEIGHT - 2 - (HEIGHT - 4) * (value / most)).toFixed(1)}`;
  });
  const line = `M${points.join("L")}`;
  return h(
    "svg",
    { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, class: "spark", role: "img", "aria-label": label, preserveAspectRatio: "none" },
    h("path", { class: "spark-area", d: `${line}L${WIDTH} ${HEIGHT}L0 ${HEIGHT}Z` }),
    h("path", { class: "spark-line", d: line }),
  );
}
