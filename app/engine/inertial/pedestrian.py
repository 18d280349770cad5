"""Steps of a session, segment by segment: what a pedestrian's samples say about motion and field."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from app.engine.inertial.attitude import Attitude, LevelledSamples, level_samples
from app.engine.inertial.conditioning import window_means
from app.engine.inertial.steps import MEMORY_S, SETTLE_S, find_steps
from app.engine.types import Float64Array, ImuSamples

FIELD_WINDOW_S = 0.16
_PAUSE_S = 0.8
_KEEP_S = MEMORY_S + SETTLE_S + _PAUSE_S
MAX_GAP_S = 1.0
"""A longer gap between segments is a time nobody watched: attitude starts anew, the tracker must allow for motion."""


@dataclass(frozen=True, slots=True)
class StepEvents:
    """Steps, oldest first.

    Attributes
    ----------
    t : array, shape (k,), s
    swing : array, shape (k,), m/s^2
        Vertical swing (see :class:`app.engine.inertial.Steps`).
    motion_heading : array, shape (k,), rad
        Mean heading of the device during the step, free azimuth.
    heading : array, shape (k,), rad
        Heading of the device at ``t``.
    mag : array, shape (k, 3), uT
        Field at ``t``: forward, left, up.
    """

    t: Float64Array
    swing: Float64Array
    motion_heading: Float64Array
    heading: Float64Array
    mag: Float64Array

    def __len__(self) -> int:
        return int(self.t.shape[0])


@dataclass(frozen=True, slots=True)
class PedestrianState:
    """What the next segment needs of the ones before: attitude, the last step, the last two seconds."""

    attitude: Attitude
    last_step_t: float
    tail: LevelledSamples


def advance(state: PedestrianState | None, samples: ImuSamples) -> tuple[PedestrianState, StepEvents]:
    """Steps that the new samples confirm.

    A step is confirmed ``SETTLE_S`` after its peak, so the last one of a segment comes with the next segment; how a
    recording is cut does not change its steps. After a gap over ``MAX_GAP_S`` the heading starts from zero again.
    """
    if state is not None and gap_before(state, samples) > 0.0:
        state = None
    levelled, attitude = level_samples(samples, state.attitude if state else None)
    if state is not None:
        levelled = _join(state.tail, levelled)
    last = state.last_step_t if state else -np.inf
    steps = find_steps(levelled.t, levelled.vertical, after=last)
    begin = np.maximum(np.concatenate(([last], steps.t[:-1])), steps.t - _PAUSE_S)[: len(steps)]
    events = StepEvents(
        t=steps.t,
        swing=steps.swing,
        motion_heading=window_means(levelled.t, levelled.heading[:, None], begin, steps.t)[:, 0],
        heading=np.interp(steps.t, levelled.t, levelled.heading),
        mag=window_means(levelled.t, levelled.mag, steps.t - FIELD_WINDOW_S, steps.t + FIELD_WINDOW_S),
    )
    if len(steps):
        last = float(steps.t[-1])
    keep = levelled.t >= levelled.t[-1] - _KEEP_S
    tail = LevelledSamples(levelled.t[keep], levelled.mag[keep], levelled.heading[keep], levelled.vertical[keep])
    return PedestrianState(replace(attitude), last, tail), events


def gap_before(state: PedestrianState, samples: ImuSamples) -> float:
    """Seconds nobody watched before these samples; 0 when they follow within ``MAX_GAP_S``."""
    gap = float(samples.t[0]) - state.attitude.t
    return gap if gap > MAX_GAP_S else 0.0


def _join(a: LevelledSamples, b: LevelledSamples) -> LevelledSamples:
    return LevelledSamples(
        np.concatenate([a.t, b.t]),
        np.concatenate([a.mag, b.mag]),
        np.concatenate([a.heading, b.heading]),
        np.concatenate([a.vertical, b.vertical]),
    )
