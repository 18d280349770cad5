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


def follow_plane(slope, base, away, dt, values, start, P0, growth, variance):
    """Errors of a track over planes, all at once: Gaussian conditioning of the stacked states, without turn or stretch.

    Returns smoothed states (n, 8 + channels), covariance of the last one, and minus twice the log density.
    """
    n, channels = values.shape
    size = len(P0)
    mean, cov = np.zeros((n, size)), np.zeros((n * size, n * size))
    F, P = np.eye(size), P0.copy()
    blocks = [P0]
    transitions = []
    for k in range(1, n):
        F = np.eye(size)
        t = dt[k]
        Q = np.zeros((size, size))
        for i in range(2):
            F[i, 2 + i], F[i, 4 + i], F[2 + i, 4 + i] = t, t * t / 2, t
            Q[i, i] = growth[0] * t + growth[1] * t**3 / 3
            Q[i, 2 + i] = Q[2 + i, i] = growth[1] * t * t / 2
            Q[2 + i, 2 + i] = growth[1] * t
        P = F @ P @ F.T + Q
        blocks.append(P)
        transitions.append(F)
    for k in range(n):
        block = blocks[k]
        for later in range(k, n):
            cov[later * size : (later + 1) * size, k * size : (k + 1) * size] = block
            cov[k * size : (k + 1) * size, later * size : (later + 1) * size] = block.T
            if later < n - 1:
                block = transitions[later] @ block
    H = np.zeros((n * channels, n * size))
    nu = np.zeros(n * channels)
    for k in range(n):
        for c in range(channels):
            row = k * channels + c
            H[row, k * size : k * size + 2] = slope[c]
            H[row, k * size + 8 + c] = 1.0
            nu[row] = values[k, c] - base[c] - slope[c] @ (start + away[k])
    S = H @ cov @ H.T + variance * np.eye(n * channels)
    gain = np.linalg.solve(S, H @ cov).T
    after = cov - gain @ H @ cov
    cost = nu @ np.linalg.solve(S, nu) + np.linalg.slogdet(S)[1]
    return mean + (gain @ nu).reshape(n, size), after[-size:, -size:], cost
