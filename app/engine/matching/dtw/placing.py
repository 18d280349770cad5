"""From a warping path to the track on the route."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from app.engine.kernels.warping import warping_path
from app.engine.matching.conclude import independent_share
from app.engine.matching.dtw.bands import Band
from app.engine.matching.dtw.library import Library
from app.engine.matching.dtw.search import Steps
from app.engine.matching.dtw.signals import Query
from app.engine.matching.problem import MatchProblem, Region
from app.engine.matching.result import Candidate
from app.engine.types import BoolArray, Float64Array, IntArray

_SIGMAS = 3.0
_ASIDE_OF_ROUTE_M = 2.0
"""How far beside a route one walks and is still on it."""
_UNTOLD_M = 100.0
"""Standard deviation along a route, or half its length if that is more, where the field tells nothing."""
_CURVE_M = 1.0
"""Distance over which the curvature of the cost is taken: the range of one fix, so that single points do not count."""


@dataclass(frozen=True, slots=True)
class Warping:
    """How a query lies on a library.

    Attributes
    ----------
    pairs : array, shape (k, 2)
        Point of the query, point of the library.
    cost : float, uT^2
        Sum of squared differences.
    residual : array, shape (k, channels), uT
    """

    pairs: IntArray
    cost: float
    residual: Float64Array


def warp(
    query: Float64Array, stretch: Float64Array, first: int, band: Band, steps: Steps, *, open_begin: bool
) -> Warping | None:
    """Cheapest path onto a stretch of a library that begins with point ``first``; None if the band holds none."""
    n, m = len(query), len(stretch)
    path = np.empty((n + m, 2), dtype=np.int64)
    cost, begin = warping_path(
        np.ascontiguousarray(query), np.ascontiguousarray(stretch), *band, steps is Steps.SKIPPING, open_begin,
        np.empty((2, m)), np.empty((n, m), dtype=np.int8), path,
    )  # fmt: skip
    if begin == len(path):
        return None
    pairs = path[begin:]
    residual = query[pairs[:, 0]] - stretch[pairs[:, 1]]
    return Warping(pairs + np.array([0, first]), float(cost), residual)


def place(
    problem: MatchProblem, query: Query, library: Library, warping: Warping, sd_along: float, aside_sd_m: float
) -> Candidate:
    """The track where the path puts it, with the covariance of its last point."""
    i, j = warping.pairs.T
    matched = np.bincount(i, weights=j) / np.bincount(i)
    at = np.interp(query.index, np.arange(len(matched)), matched)
    points = np.arange(int(j[0]), int(j[-1]) + 1)
    x, y = np.interp(at, points, library.x[points]), np.interp(at, points, library.y[points])
    track = problem.track
    moved, own = np.diff(x) + 1j * np.diff(y), np.diff(track.x) + 1j * np.diff(track.y)
    direction = np.angle(_direction(library, int(j[-1])))
    c, s = np.cos(direction), np.sin(direction)
    axes = np.array([[c, -s], [s, c]])
    return Candidate(
        x=x,
        y=y,
        cost=float(np.sqrt(warping.cost / len(query))),
        rotation=float(np.angle(np.sum(moved * np.conj(own)))),
        scale=float(np.abs(moved).sum() / max(track.length_m, 1e-6)),
        cov=axes @ np.diag([sd_along**2, aside_sd_m**2]) @ axes.T,
    )


def sd_along_route(
    problem: MatchProblem, library: Library, total: Float64Array, place_index: int, warping: Warping
) -> float:
    """Standard deviation of the end along its route, m, by the curvature of the cost about its minimum.

    Costs are chi-square up to a factor, the variance of a difference: that of sensor and map, or what the path leaves
    unexplained if that is more. Differences that are alike from point to point count once.
    """
    expected = float((problem.profile.noise_sd**2).mean()) + library.sd**2
    variance = max(expected, float((warping.residual**2).mean()), 1e-6)
    share = independent_share(warping.residual / np.sqrt(variance))
    number = library.route[place_index]
    longest = max(_UNTOLD_M, 0.5 * library.spacing_m * float((library.route == number).sum()))
    reach = max(int(round(_CURVE_M / library.spacing_m)), 1)
    rises = [
        float(total[k] - total[place_index])
        for k in (place_index - reach, place_index + reach)
        if 0 <= k < len(total) and library.route[k] == number and np.isfinite(total[k])
    ]
    information = share * max(float(np.mean(rises)) if rises else 0.0, 0.0)
    if information * longest**2 <= variance * (reach * library.spacing_m) ** 2:
        return longest
    along = (reach * library.spacing_m) ** 2 * variance / information
    return float(np.sqrt(along + library.spacing_m**2 / 12.0))


def begins_in(region: Region | None, library: Library) -> BoolArray:
    """Which points of a library the track may begin at, shape (m,)."""
    on_route: BoolArray = library.route >= 0
    if region is None:
        return on_route
    cov = region.cov + np.eye(2) * _ASIDE_OF_ROUTE_M**2
    away = np.stack([library.x - region.x, library.y - region.y])
    near: BoolArray = np.einsum("im,im->m", away, np.linalg.solve(cov, away)) <= _SIGMAS**2
    return on_route & near


def ends_in(begins: BoolArray, n: int) -> BoolArray:
    """Which points a stretch of at most ``2 n`` points can end at if it must begin at one of ``begins``."""
    count = np.concatenate([[0], np.cumsum(begins)])
    j = np.arange(len(begins))
    return np.asarray(count[j + 1] - count[np.maximum(j - 2 * n, 0)] > 0, dtype=np.bool_)


def _direction(library: Library, j: int) -> complex:
    """Step of the route about a point, as a complex number."""
    low = j - 1 if j > 0 and library.route[j - 1] == library.route[j] else j
    high = j + 1 if j + 1 < len(library) and library.route[j + 1] == library.route[j] else j
    return complex(library.x[high] - library.x[low], library.y[high] - library.y[low])
