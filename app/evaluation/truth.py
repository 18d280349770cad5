"""Ground truth of a recorded walk at its steps, and the area that a survey covers.

People pause at the labels, so between two of them truth runs linearly in *steps*, not in time.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from app.engine.types import Float64Array, Waypoints

LONGEST_STEP_S = 0.8
"""A longer interval between two steps held a pause."""
USUAL_STEP_S = 0.55
"""Duration of a step after a pause, in a walk that has no two steps in a row."""
COVERED_WITHIN_M = 1.0
COVERED_SHARE = 0.8
MIN_STEPS = 8
"""Walks with fewer steps are not scored."""

_GRID_M = 0.01


@dataclass(frozen=True, slots=True)
class WalkTruth:
    """Position at every step between the first and the last label: ``t`` (n,) s, ``x`` and ``y`` (n,) m."""

    t: Float64Array
    x: Float64Array
    y: Float64Array

    def __len__(self) -> int:
        return int(self.t.shape[0])

    @property
    def travelled(self) -> Float64Array:
        """Distance walked up to each step, shape (n,), m."""
        legs = np.hypot(np.diff(self.x), np.diff(self.y))
        return np.concatenate(([0.0], np.cumsum(legs))) if len(self) else legs


def truth_at_steps(step_t: Float64Array, waypoints: Waypoints, *, even_pace: bool = False) -> WalkTruth:
    """Truth at the steps between the first and the last waypoint.

    Parameters
    ----------
    step_t : array, shape (n,), s
        Steps of the whole recording, ascending.
    waypoints : Waypoints
    even_pace : bool
        Linear in time instead of steps.
    """
    inside = (step_t >= waypoints.t[0]) & (step_t <= waypoints.t[-1])
    t = step_t[inside]
    x, y = interpolate(t, np.empty(0) if even_pace else step_t, waypoints)
    return WalkTruth(t, x, y)


def interpolate(t: Float64Array, step_t: Float64Array, waypoints: Waypoints) -> tuple[Float64Array, Float64Array]:
    """Position at ``t`` on the straight legs between waypoints, linear in the number of steps.

    A leg on which less than one step was felt (a lift, a trolley, a missed step) is linear in time. Outside the
    waypoints' time the nearest label holds.

    Returns
    -------
    x, y : arrays of the shape of ``t``, m
    """
    labels = waypoints.t
    leg = np.clip(np.searchsorted(labels, t, side="right") - 1, 0, len(labels) - 2)
    steps_at, steps_at_label = _steps_made(t, step_t), _steps_made(labels, step_t)
    walked = np.diff(steps_at_label)[leg]
    by_steps = (steps_at - steps_at_label[leg]) / np.where(walked >= 1.0, walked, 1.0)
    by_time = (t - labels[leg]) / np.diff(labels)[leg]
    fraction = np.clip(np.where(walked >= 1.0, by_steps, by_time), 0.0, 1.0)
    x = waypoints.x[leg] + fraction * np.diff(waypoints.x)[leg]
    y = waypoints.y[leg] + fraction * np.diff(waypoints.y)[leg]
    return x, y


def _steps_made(t: Float64Array, step_t: Float64Array) -> Float64Array:
    """Steps made by time ``t``, with fractions: each grows from 0 to 1 until it is felt; flat during pauses."""
    if not len(step_t):
        return np.zeros(t.shape)
    interval = np.diff(step_t, prepend=-np.inf)
    in_a_row = interval[interval <= LONGEST_STEP_S]
    usual = float(np.median(in_a_row)) if len(in_a_row) else USUAL_STEP_S
    begin = step_t - np.where(interval <= LONGEST_STEP_S, interval, usual)
    number = np.searchsorted(step_t, t, side="left")  # steps felt before t
    ahead = np.minimum(number, len(step_t) - 1)
    under_way = np.clip((t - begin[ahead]) / (step_t - begin)[ahead], 0.0, 1.0)
    made: Float64Array = number.astype(np.float64) + np.where(number < len(step_t), under_way, 0.0)
    return made


@dataclass(frozen=True, slots=True)
class SurveyedArea:
    """Positions of all survey samples of a level, shape (n, 2), m, repetitions removed."""

    positions: Float64Array

    @classmethod
    def from_tracks(cls, tracks: Iterable[tuple[Float64Array, Float64Array]]) -> SurveyedArea:
        """Area of the survey walks, each given as ``x`` and ``y`` of its samples."""
        parts = [np.column_stack(track) for track in tracks]
        if not parts:
            return cls(np.empty((0, 2)))
        # standing still gives hundreds of equal rows, which slow the tree and say nothing
        return cls(np.unique(np.round(np.vstack(parts) / _GRID_M), axis=0) * _GRID_M)

    def share_covered(self, truth: WalkTruth) -> float:
        """Share of the steps with a survey sample within ``COVERED_WITHIN_M``."""
        if not len(self.positions) or not len(truth):
            return 0.0
        nearest, _ = cKDTree(self.positions).query(np.column_stack((truth.x, truth.y)))
        # the grid moves a sample by up to half its diagonal; on the boundary the sample counts as near enough
        return float(np.mean(nearest <= COVERED_WITHIN_M + _GRID_M))


def survey_track(t: Float64Array, step_t: Float64Array, waypoints: Waypoints) -> tuple[Float64Array, Float64Array]:
    """Positions of the samples of a survey walk that lie between its first and last label."""
    inside = (t >= waypoints.t[0]) & (t <= waypoints.t[-1])
    return interpolate(t[inside], step_t, waypoints)
