"""Where a route looks like another place of its level: what the bound of a forecast cannot see."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from app.engine.kernels import forecast as kernel
from app.engine.mapping.forecast import PHONE, RouteForecast, WalkerErrors, nearest_nodes
from app.engine.types import Float64Array, GridMap, IntArray

STRETCH_M = 40.0
"""What is compared: on floors of shopping malls most stretches of 20 m have a double somewhere, few of 40 m."""
LEAST_M = 20.0
"""Shorter routes are not compared at all."""
EVERY_M = 5.0
PITCH_M = 1.0
"""Of the nodes that are compared: the field keeps its shape over a metre."""
SAME_M = 6.0
"""Another place is at least this far off; nearer ones are what the forecast error speaks of."""
LIKE_NATS = 4.0
"""A stretch with a place less than this much less likely is ambiguous: the odds at which a search says it is sure."""
_MAPPED_SHARE = 0.8
_GOLDEN = 0.6180339887498949
_BUDGET = 20_000_000
"""Places that all stretches of a route together are compared with, about a second: on large levels a long route is
compared at fewer points."""


@dataclass(frozen=True, slots=True, eq=False)
class Rivals:
    """For stretches of a route the other place that looks most like them, the same way round.

    Attributes
    ----------
    way : array, shape (n,), m
        Where each stretch ends, along the route.
    nats : array, shape (n,)
        How much less likely the other place is, of the readings of a stretch; infinite where none comes within 4.
    distance : array, shape (n,), m
        How far off it is; NaN where there is none.
    """

    way: Float64Array
    nats: Float64Array
    distance: Float64Array

    def ambiguous(self, way: Float64Array) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
        """Whether points of the route, by their way, end a stretch that looks like another place, shape of ``way``.

        A stretch speaks for the points since the one before it; the first for all before it, where less was seen still.
        """
        found = np.zeros(len(way), dtype=bool)
        before = np.append(0.0, self.way)[: len(self.way)]  # a short route has no stretch at all
        for begin, end, nats in zip(before, self.way, self.nats, strict=True):
            if nats < LIKE_NATS:
                found |= (way <= end + 1e-9) & (way > begin + 1e-9)
        return found


def find_rivals(grid_map: GridMap, route: RouteForecast, errors: WalkerErrors = PHONE) -> Rivals:
    """Compare each stretch of a route with all places of the level.

    A sensor's offset is not known, so each channel's mean difference is left out. Readings are independent about every
    two correlation lengths of their error; both places' map errors count as noise.
    """
    pitch = max(round(PITCH_M / grid_map.cell_m), 1)
    mean = np.ascontiguousarray(np.moveaxis(grid_map.mean[:, ::pitch, ::pitch], 0, -1))
    mapped = np.ascontiguousarray(grid_map.mapped[::pitch, ::pitch])
    step = pitch * grid_map.cell_m
    row, column, _ = nearest_nodes(grid_map, route.xy)
    row, column = np.minimum(row // pitch, mapped.shape[0] - 1), np.minimum(column // pitch, mapped.shape[1] - 1)
    ends = _ends(float(route.way[-1]), max(EVERY_M, float(route.way[-1]) * mapped.size / _BUDGET))
    nats, distance = np.full(len(ends), np.inf), np.full(len(ends), np.nan)
    for i, end in enumerate(ends):
        points = _points(route, end, step)
        if not len(points):
            continue
        r, c = row[points], column[points]
        best = np.empty(3)
        weight, worst = _weight(grid_map, row[points] * pitch, column[points] * pitch, step, errors)
        least = math.ceil(_MAPPED_SHARE * len(r))
        kernel.rivals(mean, mapped, r, c, weight, least, SAME_M / step, worst, best)
        if best[0] < worst:
            nats[i], distance[i] = best[0], step * math.hypot(best[1], best[2])
    return Rivals(ends, nats, distance)


def _ends(length: float, every: float) -> Float64Array:
    if length < STRETCH_M:
        return np.array([length]) if length >= LEAST_M else np.empty(0)
    return np.arange(STRETCH_M, length + 1e-9, every)


def _points(route: RouteForecast, end: float, step: float) -> IntArray:
    """Mapped points of the stretch that ends there, about ``step`` apart; none if too little of it is mapped."""
    first, last = np.searchsorted(route.way, [end - STRETCH_M - 1e-9, end + 1e-9])
    length = float(route.way[last - 1] - route.way[first])
    every = max(round(step * (last - first) / max(length, step)), 1)
    points = np.arange(first, last, every)
    known: IntArray = points[route.mapped[points]]
    if len(known) < _MAPPED_SHARE * len(points):
        return known[:0]
    # far points first: neighbours tell the same, and most places are out after a few that do not
    return known[np.argsort(np.arange(len(known)) * _GOLDEN % 1.0)]


def _weight(
    grid_map: GridMap, row: IntArray, column: IntArray, step: float, errors: WalkerErrors
) -> tuple[Float64Array, float]:
    """Nats per squared difference of each channel, and where to stop looking."""
    unsure = (grid_map.sd[:, row, column].astype(np.float64) ** 2).mean(axis=1)
    variance = np.array(grid_map.noise_sd) ** 2 + 2.0 * unsure
    independent = min(step / (2.0 * errors.shared_m), 1.0)
    return 0.5 * independent / np.maximum(variance, 1e-4), LIKE_NATS
