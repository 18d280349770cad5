"""Errors at the corners of a track: the protocol of the ``kaist`` data set's source.

A run is scored only where the gyroscope shows a turn: the position estimated at the step of the turn against the
corner. The first two scored corners are left out (the search for the start); the mean over the rest is the run's
error. A run whose error stays below ``CONVERGED_M`` has converged.

The source takes turns and corners in their order. So that a wiggle or a missed turn does not shift all that follow,
a turn here belongs to the corner whose label is nearest in time; on the source's three tracks both are the same.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np

from app.engine.inertial import find_steps, level_samples
from app.engine.types import Fix, Float64Array, ImuSamples, IntArray, Waypoints
from app.evaluation.metrics import SAME_TIME_S

CONVERGED_M = 9.0
LEFT_OUT = 2
TURN_SD = 0.1
"""rad: standard deviation of the heading over three steps from which on they turn."""
STEPS_APART = 5
"""Of turns that are closer only the sharpest counts."""
NEAR_S = 3.0
"""A turn farther from all labels is none of the corners."""


@dataclass(frozen=True, slots=True)
class Corners:
    """Scored corners of a track: ``index`` among its waypoints, and ``t`` (s) of the turn, both shape (n,)."""

    index: IntArray
    t: Float64Array

    def __len__(self) -> int:
        return int(self.t.shape[0])


def scored_corners(samples: ImuSamples, waypoints: Waypoints) -> Corners:
    """Corners between the first and the last waypoint at which the gyroscope shows a turn."""
    turns = turn_times(samples)
    labels = waypoints.t[1:-1]
    if not len(turns) or not len(labels):
        return Corners(np.empty(0, dtype=np.int64), np.empty(0))
    gap = np.abs(turns[:, None] - labels)
    own = gap.argmin(axis=1)
    best: dict[int, int] = {}
    for turn, corner in enumerate(own.tolist()):
        known = best.get(corner)
        if gap[turn, corner] <= NEAR_S and (known is None or gap[turn, corner] < gap[known, corner]):
            best[corner] = turn
    index = np.array(sorted(best), dtype=np.int64)
    return Corners(index + 1, turns[[best[corner] for corner in index.tolist()]])


def turn_times(samples: ImuSamples) -> Float64Array:
    """Times of the steps at which the walker turns, ascending, s."""
    levelled, _ = level_samples(samples)
    steps = find_steps(levelled.t, levelled.vertical)
    if len(steps) < 3:
        return np.empty(0)
    heading = np.interp(steps.t, levelled.t, levelled.heading)
    spread = np.lib.stride_tricks.sliding_window_view(heading, 3).std(axis=1, ddof=1)
    padded = np.concatenate(([-np.inf], spread, [-np.inf]))
    peaks = np.flatnonzero((spread >= TURN_SD) & (spread > padded[:-2]) & (spread >= padded[2:]))
    kept: list[int] = []
    for peak in peaks[np.argsort(-spread[peaks], kind="stable")].tolist():
        if all(abs(peak - other) >= STEPS_APART for other in kept):
            kept.append(peak)
    return steps.t[1 + np.array(sorted(kept), dtype=np.int64)]


def corner_errors(fixes: Sequence[Fix], corners: Corners, waypoints: Waypoints) -> Float64Array:
    """Distance of the newest fix at each turn from the corner, m; infinite where there was no fix yet."""
    ordered = sorted((fix for fix in fixes if math.isfinite(fix.x + fix.y)), key=lambda fix: fix.t)
    newest = np.searchsorted([fix.t for fix in ordered], corners.t + SAME_TIME_S, side="right") - 1
    errors = np.full(len(corners), np.inf)
    for i, (fix, corner) in enumerate(zip(newest.tolist(), corners.index.tolist(), strict=True)):
        if fix >= 0:
            errors[i] = math.hypot(ordered[fix].x - waypoints.x[corner], ordered[fix].y - waypoints.y[corner])
    return errors


def run_error(errors: Float64Array) -> float | None:
    """Mean error of a run but for its first two corners, m; None if there are no more."""
    return float(errors[LEFT_OUT:].mean()) if len(errors) > LEFT_OUT else None


@dataclass(frozen=True, slots=True)
class CornerSummary:
    """The source's figures over runs; lengths in metres, None where nothing was scored.

    ``mean_all`` is None too if a run had no fix at a corner: then there is no mean.
    """

    n_runs: int
    converged_share: float | None
    mean_converged: float | None
    mean_all: float | None

    def as_dict(self) -> dict[str, int | float | None]:
        """Plain values for JSON."""
        return {name: round(value, 4) if isinstance(value, float) else value for name, value in asdict(self).items()}


def summarize_runs(errors: Sequence[float | None]) -> CornerSummary:
    """Summary of the runs' errors; runs without scored corners are left out."""
    known = np.array([error for error in errors if error is not None])
    if not len(known):
        return CornerSummary(0, None, None, None)
    converged = known < CONVERGED_M
    mean = float(known.mean())
    return CornerSummary(
        n_runs=len(known),
        converged_share=float(converged.mean()),
        mean_converged=float(known[converged].mean()) if converged.any() else None,
        mean_all=mean if math.isfinite(mean) else None,
    )
