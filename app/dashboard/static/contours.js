// Lines of equal value through a raster, by marching squares.

// Which edges of a square the line crosses, by the corners that lie above: 1 low left, 2 low right, 4 high right,
// 8 high left. Edges: 0 bottom, 1 right, 2 top, 3 left. The saddles (5, 10) are told apart by the mean of the corners.
const CROSSED = [
  [], [[3, 0]], [[0, 1]], [[3, 1]], [[1, 2]], [[3, 0], [1, 2]], [[0, 2]], [[3, 2]],
  [[2, 3]], [[2, 0]], [[0, 1], [2, 3]], [[2, 1]], [[1, 3]], [[1, 0]], [[0, 3]], [],
];

/**
 * Line segments of one level.
 *
 * @param {{values, rows, columns, x0, y0, cell_m}} raster  squares with a NaN corner have none
 * @param {number} level
 * @returns {Float32Array}  x, y of both ends, four numbers a segment, metres
 */
export function contourSegments({ values, rows, columns, x0, y0, cell_m }, level) {
  const out = [];
  for (let row = 0; row + 1 < rows; row += 1) {
    for (let column = 0; column + 1 < columns; column += 1) {
      const i = row * columns + column;
      const corners = [values[i], values[i + 1], values[i + columns + 1], values[i + columns]];
      const sum = corners[0] + corners[1] + corners[2] + corners[3];
      if (!Number.isFinite(sum)) continue;
      let above = 0;
      for (let k = 0; k < 4; k += 1) if (corners[k] >= level) above |= 1 << k;
      if (above === 0 || above === 15) continue;
      // of a saddle whose middle is above, the two corners below are cut off, not the two above
      if ((above === 5 || above === 10) && sum / 4 >= level) above = 15 - above;
      for (const edges of CROSSED[above]) for (const edge of edges) push(out, edge, corners, level, x0 + column * cell_m, y0 + row * cell_m, cell_m);
    }
  }
  return Float32Array.from(out);
}

function push(out, edge, corners, level, x, y, cell) {
  const from = corners[edge];
  const share = (level - from) / (corners[(edge + 1) % 4] - from);
  if (edge === 0) out.push(x + share * cell, y);
  else if (edge === 1) out.push(x + cell, y + share * cell);
  else if (edge === 2) out.push(x + (1 - share) * cell, y + cell);
  else out.push(x, y + (1 - share) * cell);
}

/** Contours of several levels as one path in metres. */
export function contourPath(raster, levels) {
  const path = new Path2D();
  for (const level of levels) {
    const segments = contourSegments(raster, level);
    for (let i = 0; i < segments.length; i += 4) {
      path.moveTo(segments[i], segments[i + 1]);
      path.lineTo(segments[i + 2], segments[i + 3]);
    }
  }
  return path;
}
