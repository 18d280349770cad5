"""Slow twins of `app.engine.kernels.contours` and `app.engine.kernels.following`."""

from __future__ import annotations

import numpy as np


def contour_samples(plane, value, fine=2001):
    """Points of the contour inside all cells, each cell cut into lines across both ways; shape (k, 2): column, row."""
    found = [np.zeros((0, 2))]
    rows, columns = plane.shape
    t = np.linspace(0.0, 1.0, fine)
    for i in range(rows - 1):
        for j in range(columns - 1):
            m = plane[i : i + 2, j : j + 2].astype(float)
            if not np.all(np.isfinite(m)):
                continue
            for across in (m, m.T):  # along each line across the cell the map is linear
                low, high = (
                    across[0, 0] + t * (across[0, 1] - across[0, 0]),
                    across[1, 0] + t * (across[1, 1] - across[1, 0]),
                )
                crosses = (low <= value) != (high <= value)
                s = (value - low[crosses]) / (high[crosses] - low[crosses])
                uv = np.stack([t[crosses], s], axis=1)
                found.append((uv if across is m else uv[:, ::-1]) + (j, i))
    return np.concatenate(found)


def nearest_point(plane, x, y, value, radius):
    """Nearest of the contour's samples, and its distance; infinite beyond the radius."""
    points = contour_samples(plane, value)
    if not len(points):
        return np.array([x, y, np.inf])
    away = np.hypot(points[:, 0] - x, points[:, 1] - y)
    best = int(np.argmin(away))
    if not away[best] < radius:
        return np.array([x, y, np.inf])
    return np.array([*points[best], away[best]])
