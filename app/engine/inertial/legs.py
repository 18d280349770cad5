"""Positions between waypoints by step count, and the heading of the walk in the level frame."""

from __future__ import annotations

import numpy as np

from app.engine.inertial.attitude import LevelledSamples
from app.engine.inertial.steps import SETTLE_S, Steps
from app.engine.inertial.stride import step_durations, stride_length
from app.engine.types import Float64Array, Waypoints

_STEP_S = 0.8
"""A step's displacement happens within this time before it; a longer interval was a pause."""
_MIN_STEPS = 2.0
_SCALE_STEPS = 8
"""Fewer steps say little of a stride: one more or less is an eighth."""
_SCALE_RANGE = (0.5, 2.0)
"""Beyond, labels or steps are wrong: nobody's stride is."""
_DRIFT_S = 40.0
"""Time over which the heading offset of a walk may change: gyroscope drift and changes of carrying."""


def step_count(t: Float64Array, steps: Steps) -> Float64Array:
    """Fractional number of steps made by time ``t``; flat during pauses. Shape of ``t``."""
    if len(steps) == 0:
        return np.zeros_like(t)
    before = np.concatenate(([steps.t[0] - _STEP_S], steps.t[:-1]))
    begin = np.maximum(before, steps.t - _STEP_S)
    knots = np.stack([begin, steps.t], axis=1).ravel()
    counts = np.stack([np.arange(len(steps)), np.arange(1, len(steps) + 1)], axis=1).ravel()
    # a step that begins where the last one ended gives two equal knots of equal value: interp takes both
    count: Float64Array = np.interp(t, knots, counts.astype(float))
    return count


def positions_by_steps(t: Float64Array, steps: Steps, waypoints: Waypoints) -> tuple[Float64Array, Float64Array]:
    """Position at ``t`` on the straight legs between waypoints, linear in steps (in time where a leg has none).

    Returns
    -------
    x, y : arrays of the shape of ``t``, m; NaN outside the waypoints' time.
    """
    x = np.full(t.shape, np.nan)
    y = np.full(t.shape, np.nan)
    count = step_count(t, steps)
    at_waypoints = step_count(waypoints.t, steps)
    for a in range(len(waypoints) - 1):
        t0, t1 = waypoints.t[a], waypoints.t[a + 1]
        inside = (t >= t0) & (t <= t1)
        walked = at_waypoints[a + 1] - at_waypoints[a]
        if walked >= _MIN_STEPS:
            f = (count[inside] - at_waypoints[a]) / walked
        else:
            f = (t[inside] - t0) / (t1 - t0)
        x[inside] = waypoints.x[a] + f * (waypoints.x[a + 1] - waypoints.x[a])
        y[inside] = waypoints.y[a] + f * (waypoints.y[a + 1] - waypoints.y[a])
    return x, y


def stride_scale(steps: Steps, end: float, waypoints: Waypoints) -> float | None:
    """Walked distance over the modelled one, from the first to the last waypoint.

    Parameters
    ----------
    steps : Steps
        Of the whole walk.
    end : float, s
        Time of the last sample: steps of the last ``SETTLE_S`` before it are not found, and counted at the mean pace.
    waypoints : Waypoints
        The distance is that of the straight legs between them.

    Returns
    -------
    float or None
        None where too few steps lie between the waypoints, or the ratio cannot be a stride's.
    """
    begin, over = float(waypoints.t[0]), float(waypoints.t[-1])
    inside = (steps.t > begin) & (steps.t <= over)
    if int(inside.sum()) < _SCALE_STEPS:
        return None
    modelled = stride_length(steps.swing, step_durations(steps.t, -np.inf))[inside].sum()
    seen = (min(over, end - SETTLE_S) - begin) / (over - begin)
    walked = np.hypot(np.diff(waypoints.x), np.diff(waypoints.y)).sum()
    scale = float(walked * seen / modelled)
    return scale if _SCALE_RANGE[0] <= scale <= _SCALE_RANGE[1] else None


def heading_offset(levelled: LevelledSamples, steps: Steps, waypoints: Waypoints) -> Float64Array:
    """Angle from the free-azimuth heading to the level frame at each sample, shape (n,), rad.

    Each leg between waypoints gives one offset: its bearing minus the direction of the dead-reckoned displacement
    over the same time. Legs are averaged with weights of length and nearness in time.
    """
    heading = np.interp(steps.t, levelled.t, levelled.heading)
    east, north = np.cumsum(np.cos(heading)), np.cumsum(np.sin(heading))
    at = np.searchsorted(steps.t, waypoints.t, side="right")
    total = np.concatenate(([0.0], east)) + 1j * np.concatenate(([0.0], north))
    walked = np.diff(total[at])
    plan = np.diff(waypoints.x) + 1j * np.diff(waypoints.y)
    weight = np.minimum(np.abs(plan), 2.0 * np.abs(walked))
    if not np.any(weight > 0):
        return np.zeros(len(levelled))
    turn = np.where(weight > 0, plan * np.conj(walked), 0.0)
    turn = np.where(np.abs(turn) > 0, turn / np.maximum(np.abs(turn), 1e-12), 0.0)
    middle = 0.5 * (waypoints.t[1:] + waypoints.t[:-1])
    near = np.exp(-0.5 * ((levelled.t[:, None] - middle) / _DRIFT_S) ** 2) + 1e-6
    offset: Float64Array = np.unwrap(np.angle((near * weight) @ turn))
    return offset
