"""All routes of a problem, both ways, as one long sequence, and that sequence in the lanes of the kernels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from app.engine.errors import InputError
from app.engine.kernels.lanes import LANES
from app.engine.matching.dtw.signals import Treatment, in_route_frame
from app.engine.matching.problem import MatchProblem, RouteMap, common_features, reduce_features
from app.engine.types import BoolArray, FeatureSet, Float64Array, IntArray

_GAP = 2
"""Points between two routes: more than a step of any pattern skips."""
_NOWHERE = 1e5
"""uT: dearer than anything, and exact enough in float32 that a path along a route feels nothing of it."""


@dataclass(frozen=True, slots=True)
class Library:
    """Routes one after another, each forth and back.

    Attributes
    ----------
    values : array, shape (m, channels), uT
        As compared; far from everything between two routes.
    x, y : array, shape (m,), m
    route : array, shape (m,), int64
        Number of the route and direction that a point belongs to, -1 between two.
    begin : array, shape (m,), int64
        First point of the route that a point belongs to.
    spacing_m : float, m
    sd : float, uT
        Typical standard deviation of the routes' map.
    """

    values: Float64Array
    x: Float64Array
    y: Float64Array
    route: IntArray
    begin: IntArray
    spacing_m: float
    sd: float

    def __len__(self) -> int:
        return int(self.values.shape[0])

    def runs(self, n: int) -> BoolArray:
        """Whether ``n`` points from each one on are all of one route, shape (m,)."""
        whole = np.zeros(len(self), dtype=np.bool_)
        if n <= len(self):
            first, last = self.route[: len(self) - n + 1], self.route[n - 1 :]
            whole[: len(first)] = (first == last) & (first >= 0)
        return whole


def routes_spacing(problem: MatchProblem, spacing_m: float, points: int) -> float:
    """Distance at which to compare: as asked (0: the routes' own), and no less than gives the track ``points`` points.

    Raises
    ------
    InputError
        There are no routes.
    """
    if not problem.routes:
        raise InputError(
            "routes", "a sequence is compared with lines of the map, and the problem has none: give routes"
        )
    own = spacing_m if spacing_m > 0.0 else float(np.median([route.spacing_m for route in problem.routes]))
    return max(own, problem.track.length_m / points)


def routes_features(problem: MatchProblem) -> FeatureSet:
    """The features that the profile and all routes can give."""
    return common_features(problem.profile.features, *(route.features for route in problem.routes))


def library_of(
    routes: Sequence[RouteMap], features: FeatureSet, spacing_m: float, treatment: Treatment
) -> Library | None:
    """Routes at one spacing as a library; None if none of them is long enough to be treated."""
    values, xs, ys, numbers, begins, sds = [], [], [], [], [], []
    total = 0
    directed = [way for route in routes for way in (route, route.reversed())]
    for number, way in enumerate(directed):
        x, y, direction, mean, sd = _at_spacing(way, features, spacing_m)
        treated, cut = treatment(in_route_frame(mean, features, direction))
        n = len(treated)
        if n == 0:
            continue
        values += [treated, np.full((_GAP, treated.shape[1]), _NOWHERE)]
        xs += [x[cut : cut + n], np.zeros(_GAP)]
        ys += [y[cut : cut + n], np.zeros(_GAP)]
        numbers += [np.full(n, number), np.full(_GAP, -1)]
        begins.append(np.full(n + _GAP, total))
        sds.append(sd)
        total += n + _GAP
    if not values:
        return None
    return Library(
        values=np.concatenate(values),
        x=np.concatenate(xs),
        y=np.concatenate(ys),
        route=np.concatenate(numbers).astype(np.int64),
        begin=np.concatenate(begins).astype(np.int64),
        spacing_m=spacing_m,
        sd=float(np.sqrt(np.mean(np.concatenate(sds) ** 2))),
    )


def _at_spacing(
    way: RouteMap, features: FeatureSet, spacing_m: float
) -> tuple[Float64Array, Float64Array, Float64Array, Float64Array, Float64Array]:
    """Places (x, y), direction, mean and standard deviation of a route at another spacing."""
    mean, sd = reduce_features(way.mean, way.sd, way.features, features)
    if np.isclose(spacing_m, way.spacing_m, rtol=1e-6):
        return way.x, way.y, way.direction, mean, sd
    own = np.arange(len(way)) * way.spacing_m
    at = np.arange(0.0, float(own[-1]) + 1e-9, spacing_m)
    x, y = np.interp(at, own, way.x), np.interp(at, own, way.y)
    mean, sd = (np.stack([np.interp(at, own, channel) for channel in part.T], axis=1) for part in (mean, sd))
    direction = np.arctan2(np.gradient(y), np.gradient(x)) if len(at) > 1 else np.zeros(len(at))
    return x, y, direction, mean, sd


def into_lanes(values: Float64Array, before: int, after: int, *, fill: float = _NOWHERE) -> tuple[Float64Array, int]:
    """A sequence cut into one chunk per lane, each with some of its neighbours.

    Parameters
    ----------
    values : array, shape (m, channels)
    before, after : int
        Points of the neighbours that a chunk repeats on either side.
    fill : float
        What stands before the first and after the last point.

    Returns
    -------
    lanes : array, shape (before + step + after, channels, LANES)
        Point ``k * step + p`` of the sequence is ``lanes[before + p, :, k]``. The number of positions is even.
    step : int
    """
    step = max(-(-len(values) // LANES), 1)
    step += (before + step + after) % 2
    padded = np.full((before + LANES * step + after, values.shape[1]), fill)
    padded[before : before + len(values)] = values
    chunks = np.lib.stride_tricks.sliding_window_view(padded, before + step + after, axis=0)[::step]
    return np.ascontiguousarray(chunks[:LANES].transpose(2, 1, 0)), step


def out_of_lanes(lanes: Float64Array, m: int) -> Float64Array:
    """Results of shape (step, LANES) in the order of the sequence, shape (m,)."""
    return lanes.T.ravel()[:m]
