"""Lowest places of a cost: on a lattice, and between its nodes by a quadratic."""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations

import numpy as np
from scipy.ndimage import minimum_filter

from app.engine.types import Float32Array, Float64Array, IntArray

Cost = Callable[[Float64Array], Float64Array]
"""Costs (p,) of places (p, d); infinite where there is none."""


def local_minima(cost: Float64Array | Float32Array, count: int) -> IntArray:
    """The lowest nodes that are no higher than their neighbours, lowest first: row and column, shape (<= count, 2)."""
    lowest = np.isfinite(cost) & (cost <= minimum_filter(cost, 3, mode="nearest"))
    row, column = np.nonzero(lowest)
    order = np.argsort(cost[row, column], kind="stable")[:count]
    return np.stack([row[order], column[order]], axis=1)


def descend(
    cost: Cost, places: Float64Array, step: Float64Array, low: Float64Array, high: Float64Array, *, iterations: int
) -> tuple[Float64Array, Float64Array, int]:
    """Bring places down to the bottom of the quadratic through their surroundings, all side by side.

    Each iteration lays a quadratic through the costs one step around each place and goes to its bottom, at most two
    steps away; where it has none, or the bottom is no better, to the best place seen, with half the steps from there.

    Parameters
    ----------
    cost : callable
    places : array, shape (p, d)
    step : array, shape (d,)
        0 for what stays as it is.
    low, high : array, shape (d,)
        Bounds.
    iterations : int

    Returns
    -------
    places, array of shape (p, d); their costs, shape (p,); how many costs were asked for
    """
    free = np.flatnonzero(step)
    stencil = _stencil(len(free))
    places, steps, asked = places.copy(), np.repeat(step[None, free], len(places), axis=0), 0
    best = cost(places)
    for _ in range(iterations):
        around = np.repeat(places[:, None], len(stencil), axis=1)
        around[:, :, free] += stencil * steps[:, None]
        around = np.clip(around, low, high)
        costs = cost(around.reshape(-1, places.shape[1])).reshape(around.shape[:2])
        bottom = places.copy()
        bottom[:, free] += steps * _bottoms(costs, len(free))
        bottom = np.clip(bottom, low, high)
        tried = np.concatenate([costs, cost(bottom)[:, None]], axis=1)
        asked += tried.size
        pick = tried.argmin(axis=1)
        better = tried[np.arange(len(places)), pick] < best
        chosen = np.concatenate([around, bottom[:, None]], axis=1)[np.arange(len(places)), pick]
        steps[(pick == 0) | (pick == len(stencil)) | ~better] *= 0.5
        places[better], best[better] = chosen[better], tried[np.arange(len(places)), pick][better]
    return places, best, asked


def _stencil(d: int) -> Float64Array:
    """The middle, both ways along each axis, and one corner of each pair of axes: as many as a quadratic has terms."""
    eye = np.eye(d)
    pairs = [eye[a] + eye[b] for a, b in combinations(range(d), 2)]
    return np.concatenate([np.zeros((1, d)), eye, -eye, np.array(pairs).reshape(-1, d)])


def _bottoms(costs: Float64Array, d: int) -> Float64Array:
    """Bottom of the quadratic through costs on the stencil (p, terms), in steps; 0 where it has none."""
    c0, up, down, pairs = costs[:, 0], costs[:, 1 : d + 1], costs[:, d + 1 : 2 * d + 1], costs[:, 2 * d + 1 :]
    known = np.isfinite(costs).all(axis=1)
    with np.errstate(invalid="ignore"):
        slope = 0.5 * (up - down)
        curvature = np.zeros((len(costs), d, d))
        curvature[:, range(d), range(d)] = up - 2.0 * c0[:, None] + down
        for k, (a, b) in enumerate(combinations(range(d), 2)):
            curvature[:, a, b] = curvature[:, b, a] = pairs[:, k] - up[:, a] - up[:, b] + c0
    curvature[~known], slope[~known] = np.eye(d), 0.0
    values, vectors = np.linalg.eigh(curvature)
    convex = values[:, 0] > 1e-9 * np.maximum(np.abs(values).max(axis=1), 1e-12)
    values = np.where(convex[:, None], values, 1.0)
    bottom: Float64Array = -np.einsum("pij,pj,pkj,pk->pi", vectors, 1.0 / values, vectors, slope)
    bottom[~convex] = 0.0
    return np.asarray(np.clip(bottom, -2.0, 2.0))
