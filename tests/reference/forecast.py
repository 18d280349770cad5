"""Slow twin of the accuracy forecast: all unknowns of a walk at once, as one linear Gaussian problem."""

from __future__ import annotations

import numpy as np

from app.engine.mapping.forecast import WalkerErrors
from app.engine.types import BoolArray, Float32Array, Float64Array


def posterior_covariances(
    nodes: Float32Array,
    mapped: BoolArray,
    steps: Float64Array,
    noise_sd: tuple[float, ...],
    errors: WalkerErrors,
    *,
    vector: bool,
) -> Float64Array:
    """Covariance of the position at each point of a walk, given the readings up to it, shape (n, 2, 2), m^2.

    Unknowns are the start's state and each leg's dead-reckoning errors; the covariance matrix of all readings is
    written out entry by entry, then conditioned on.

    Parameters
    ----------
    nodes : array, shape (n, channels, 4)
        Mean, slopes along x and y, variance of the map at each point.
    mapped : array, shape (n,), bool
    steps : array, shape (n, 2), m
        From the point before; the first is what its reading stands for.
    """
    n, channels, _ = nodes.shape
    ds = np.hypot(*steps.T)
    heading = np.arctan2(steps[:, 1], steps[:, 0])
    way = np.concatenate([[0.0], np.cumsum(ds[1:])])
    # unknowns: x, y, heading and offsets at the start, then (along, across, heading, offsets) of every leg
    per_leg = 3 + channels
    prior = [errors.position_m**2] * 2 + [errors.heading**2] + [errors.offset**2] * channels
    leg = np.array([errors.along**2, errors.across**2, errors.heading_walk**2] + [errors.offset_walk**2] * channels)
    cov_unknown = np.diag(np.concatenate([prior, *(leg * d for d in ds[1:])]))
    state = np.zeros((n, 3 + channels, len(cov_unknown)))
    state[0, :, : 3 + channels] = np.eye(3 + channels)
    for i in range(1, n):
        u = np.array([np.cos(heading[i]), np.sin(heading[i])])
        v = np.array([-u[1], u[0]])
        state[i] = state[i - 1]
        state[i, :2] += np.outer(v * ds[i], state[i - 1, 2])
        at = (3 + channels) + (i - 1) * per_leg
        state[i, :2, at] += u
        state[i, :2, at + 1] += v
        state[i, 2:, at + 2 : at + per_leg] += np.eye(1 + channels)
    readings = [(i, k) for i in range(n) if mapped[i] for k in range(channels)]
    slope = np.array([_slope(nodes[i], k, heading[i], vector=vector) @ state[i] for i, k in readings])
    cov_reading = slope @ cov_unknown @ slope.T
    for a, (i, k) in enumerate(readings):
        for b, (j, m) in enumerate(readings):
            if k != m:
                continue
            shared = [np.sqrt(errors.shared * noise_sd[k] ** 2 + nodes[p, k, 3]) for p in (i, j)]
            cov_reading[a, b] += shared[0] * shared[1] * np.exp(-abs(way[i] - way[j]) / errors.shared_m)
        cov_reading[a, a] += (1 - errors.shared) * noise_sd[k] ** 2 * errors.reading_m / ds[i]
    found = np.empty((n, 2, 2))
    for i in range(n):
        seen = [a for a, (j, _) in enumerate(readings) if j <= i]
        place = state[i, :2] @ cov_unknown
        cross = place @ slope[seen].T
        before = place @ state[i, :2].T
        found[i] = before - cross @ np.linalg.solve(cov_reading[np.ix_(seen, seen)], cross.T)
    return found


def likest_place(
    mean: Float32Array,
    mapped: BoolArray,
    rows: Float64Array,
    columns: Float64Array,
    weight: Float64Array,
    *,
    least: int,
    near: float,
) -> tuple[float, int, int]:
    """Smallest weighted sum of squares of a stretch about its mean difference to another place, and the move to it."""
    best = (np.inf, 0, 0)
    height, width, _ = mean.shape
    for dr in range(-height, height):
        for dc in range(-width, width):
            r, c = rows + dr, columns + dc
            if np.hypot(dr, dc) < near or r.min() < 0 or c.min() < 0 or r.max() >= height or c.max() >= width:
                continue
            known = mapped[r, c]
            if known.sum() < least:
                continue
            gap = (mean[r, c].astype(float) - mean[rows, columns])[known]
            cost = float((weight * ((gap - gap.mean(axis=0)) ** 2).sum(axis=0)).sum()) * len(rows) / known.sum()
            best = min(best, (cost, dr, dc))
    return best


def _slope(node: Float32Array, k: int, heading: float, *, vector: bool) -> Float64Array:
    """Change of a reading with (x, y, heading, offsets)."""
    channels = len(node)
    offset = np.eye(channels)[k]
    turn = 0.0
    if vector and k < 2:
        c, s = np.cos(heading), np.sin(heading)
        offset = np.array([[c, -s, 0.0], [s, c, 0.0]])[k]
        turn = float(node[1, 0] if k == 0 else -node[0, 0])
    return np.concatenate([[node[k, 1], node[k, 2], turn], offset])
