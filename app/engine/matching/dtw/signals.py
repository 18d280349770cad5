"""From a track's readings to a sequence that can be warped onto a route, and the same treatment of the route."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from app.engine.matching.problem import MatchProblem
from app.engine.types import FeatureSet, Float64Array


class Resample(StrEnum):
    """What the query's points are equally far apart in: way by the odometry, or time."""

    DISTANCE = "distance"
    TIME = "time"


class Centre(StrEnum):
    """How what the sensor adds to every reading is taken out of the comparison.

    * ``none``: it is not.
    * ``mean``: query and map are compared less their means nearby.
    * ``difference``: changes from point to point are compared.
    """

    NONE = "none"
    MEAN = "mean"
    DIFFERENCE = "difference"


Treatment = Callable[[Float64Array], tuple[Float64Array, int]]
"""Sequence of shape (n, channels) in; out, what is compared, and how many points were cut from the beginning."""


@dataclass(frozen=True, slots=True)
class Query:
    """A track's readings at equal distances.

    Attributes
    ----------
    values : array, shape (n, channels), uT
        As compared.
    spacing_m : float, m
    index : array, shape (len(track),)
        Where the track's points lie among the query's, counted in points of the query.
    cut : int
        Points that the treatment left out at the beginning.
    """

    values: Float64Array
    spacing_m: float
    index: Float64Array
    cut: int

    def __len__(self) -> int:
        return int(self.values.shape[0])


def query_of(
    problem: MatchProblem,
    features: FeatureSet,
    spacing_m: float,
    treatment: Treatment,
    *,
    resample: Resample = Resample.DISTANCE,
    speed_mps: float | None = None,
) -> Query | None:
    """The profile at equal distances, as a route's is stored; None if it is made of fewer than four points.

    Parameters
    ----------
    problem : MatchProblem
    features : FeatureSet
        ``vector`` is along, left, up of the track's own headings.
    spacing_m : float, m
    treatment : Treatment
    resample : Resample
    speed_mps : float or None, m/s
        With ``time``: the speed that turns time into way; None takes the track's mean speed.
    """
    track = problem.track
    axis = track.way
    if resample is Resample.TIME:
        elapsed = track.t - track.t[0]
        if speed_mps is None:
            speed_mps = float(axis[-1] / elapsed[-1]) if len(track) > 1 and elapsed[-1] > 0.0 else 0.0
        axis = elapsed * speed_mps
    values = in_route_frame(problem.profile.as_features(features).values, features, track.heading)
    at = np.arange(0.0, float(axis[-1]) + 1e-9, spacing_m)
    moving = np.concatenate([[True], np.diff(axis) > 0.0])
    even = np.stack([np.interp(at, axis[moving], channel[moving]) for channel in values.T], axis=1)
    treated, cut = treatment(even)
    if min(len(treated), len(track)) < 4:
        return None
    return Query(treated, spacing_m, np.clip(axis / spacing_m - cut, 0.0, len(treated) - 1.0), cut)


def in_route_frame(values: Float64Array, features: FeatureSet, direction: Float64Array) -> Float64Array:
    """Vectors of the level frame as along, left, up of the way, which needs no compass to compare; others as they are.

    Parameters
    ----------
    values : array, shape (n, channels), uT
    features : FeatureSet
    direction : array, shape (n,), rad
        Of the way at each point.
    """
    if features is not FeatureSet.VECTOR:
        return values
    c, s = np.cos(direction), np.sin(direction)
    x, y, z = values.T
    return np.stack([c * x + s * y, c * y - s * x, z], axis=1)


def as_it_is(values: Float64Array) -> tuple[Float64Array, int]:
    """No treatment."""
    return values, 0


def untreated(treatment: Treatment) -> Treatment:
    """The sequence itself, cut as another treatment cuts it."""

    def cut_alike(values: Float64Array) -> tuple[Float64Array, int]:
        treated, cut = treatment(values)
        return values[cut : cut + len(treated)], cut

    return cut_alike


def difference(values: Float64Array) -> tuple[Float64Array, int]:
    """Change from each point to the next."""
    return np.diff(values, axis=0), 0


def derivative(values: Float64Array) -> tuple[Float64Array, int]:
    """Slope by two neighbours, ``((p_i - p_{i-1}) + (p_{i+1} - p_{i-1}) / 2) / 2``, without both ends.

    Keogh and Pazzani 2001, doi:10.1137/1.9781611972719.1. They copy the slopes at the ends from their neighbours;
    here these are left out, so that a window of a route's slopes is the same as the slopes of a window.
    """
    if len(values) < 3:
        return values[:0], 1
    before, here, after = values[:-2], values[1:-1], values[2:]
    return ((here - before) + (after - before) / 2.0) / 2.0, 1


def high_pass(window: int, *, whole: bool) -> Treatment:
    """Treatment that takes out the mean over ``window`` points about each, over fewer where the sequence ends.

    Near the ends of a profile that mean is one-sided, where a route's is not: unless the ``whole`` is asked for, they
    are left out, up to a quarter of the profile at either end.
    """

    def less_local_mean(values: Float64Array) -> tuple[Float64Array, int]:
        total = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(values, axis=0)])
        n, half = len(values), window // 2
        low, high = np.maximum(np.arange(n) - half, 0), np.minimum(np.arange(n) + half + 1, n)
        passed = values - (total[high] - total[low]) / (high - low)[:, None]
        cut = 0 if whole else min(half, n // 4)
        return passed[cut : n - cut], cut

    return less_local_mean
