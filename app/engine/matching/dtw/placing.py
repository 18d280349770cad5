"""From a warping path to the track on the route."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from app.engine.kernels.warping import warping_path
from app.engine.matching.conclude import independent_share
from app.engine.matching.dtw.bands import Band, full_band
from app.engine.matching.dtw.library import Library
from app.engine.matching.dtw.search import Steps
from app.engine.matching.dtw.signals import Query
from app.engine.matching.problem import MatchProblem, Region
from app.engine.matching.result import Candidate
from app.engine.types import BoolArray, Float64Array, IntArray

_SIGMAS = 3.0
_ROUNDS = 2
_ASIDE_OF_ROUTE_M = 2.0
"""How far beside a route one walks and is still on it."""
_UNTOLD_M = 100.0
"""Standard deviation along a route, or half its length if that is more, where the field tells nothing."""
_NO_PATH = 1e8
"""uT^2: a path over ground between two routes costs more, none along a route does."""
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
    ends : array, shape (m,), uT^2
        Cost by point of the stretch at which the path may end.
    first : int
        Point of the library with which the stretch begins.
    """

    pairs: IntArray
    cost: float
    residual: Float64Array
    ends: Float64Array
    first: int


def warp(
    query: Float64Array,
    stretch: Float64Array,
    first: int,
    band: Band,
    steps: Steps,
    *,
    open_ends: tuple[bool, bool] = (False, False),
    uneven: float = 0.0,
) -> Warping | None:
    """Cheapest path onto a stretch of a library that begins with point ``first``; None if the band holds none."""
    n, m = len(query), len(stretch)
    path = np.empty((n + m, 2), dtype=np.int64)
    costs = np.empty((2, m))
    cost, begin = warping_path(
        np.ascontiguousarray(query), np.ascontiguousarray(stretch), *band, steps is Steps.SKIPPING, uneven, open_ends,
        costs, np.empty((n, m), dtype=np.int8), path,
    )  # fmt: skip
    if begin == len(path):
        return None
    pairs = path[begin:]
    residual = query[pairs[:, 0]] - stretch[pairs[:, 1]]
    return Warping(pairs + np.array([0, first]), float(cost), residual, costs[(n - 1) % 2], first)


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


def sd_along_route(problem: MatchProblem, library: Library, costs: Float64Array, best: int, warping: Warping) -> float:
    """Standard deviation of the end along its route, m, by the curvature of the cost about its minimum.

    Costs are chi-square up to a factor, the variance of a difference: that of sensor and map, or what the path leaves
    unexplained if that is more. Differences that are alike from point to point count once.

    Parameters
    ----------
    problem : MatchProblem
    library : Library
    costs : array, shape (m,), uT^2
        By place, points of one route apart from each other; places that are none are infinite.
    best : int
        Index of the minimum.
    warping : Warping
    """
    expected = float((problem.profile.noise_sd**2).mean()) + library.sd**2
    variance = max(expected, float((warping.residual**2).mean()), 1e-6)
    # the query may have more points than the track: those between two readings tell nothing of their own
    every = max(round(len(warping.pairs) / len(problem)), 1)
    share = independent_share(warping.residual[::every] / np.sqrt(variance)) / every
    number = library.route[warping.pairs[-1, 1]]
    longest = max(_UNTOLD_M, 0.5 * library.spacing_m * float((library.route == number).sum()))
    reach = max(round(_CURVE_M / library.spacing_m), 1)
    both = [costs[k] for k in (best - reach, best + reach) if 0 <= k < len(costs) and costs[k] < _NO_PATH]
    rise = max(float(np.mean(both)) - float(costs[best]), 0.0) if both else 0.0
    squared = (reach * library.spacing_m) ** 2 * variance
    if share * rise * longest**2 <= squared:
        return longest
    return float(np.sqrt(squared / (share * rise) + library.spacing_m**2 / 12.0))


def settle(
    raw: Float64Array,
    cut: int,
    library: Library,
    warping: Warping,
    steps: Steps,
    *,
    separation_m: float,
    centred: bool,
    uneven: float,
) -> Warping:
    """The path once more on the readings themselves, less the offset that the first path shows, with both ends open.

    What :func:`high_pass` or a difference leaves of a short profile is little, and at its ends something else than what
    it leaves of the route; with the offset known there is no need of either.

    Parameters
    ----------
    raw : array, shape (n, channels), uT
        Query, the readings themselves.
    cut : int
        Points of it that come before the first that ``warping`` is about.
    library : Library
        The map itself.
    warping : Warping
    steps : Steps
    separation_m : float, m
        How far the ends may move.
    centred : bool
        Whether there is an offset to take out.
    uneven : float, uT^2
        Cost of a step off the diagonal.
    """
    reach = round(separation_m / library.spacing_m) + 2 * cut
    begin, end = int(warping.pairs[0, 1]), int(warping.pairs[-1, 1])
    low = max(begin - reach, int(library.begin[begin]))
    on_route = library.route[low : end + reach + 1] == library.route[end]
    stretch = library.values[low : end + reach + 1][on_route]
    band = full_band(len(raw), len(stretch))
    for _ in range(_ROUNDS if centred else 1):
        i, j = warping.pairs.T
        offset = (raw[i + cut] - library.values[j]).mean(axis=0) if centred else np.zeros(raw.shape[1])
        again = warp(raw - offset, stretch, low, band, steps, open_ends=(True, True), uneven=uneven)
        if again is None:
            break
        warping, cut = again, 0
    return warping


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
