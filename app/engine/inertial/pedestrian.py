"""Steps of a session, segment by segment: what a pedestrian's samples say about motion and field."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from app.engine.inertial.attitude import Attitude, LevelledSamples, level_samples
from app.engine.inertial.carrying import Carrying, follow
from app.engine.inertial.conditioning import window_means
from app.engine.inertial.counter import Pedometer
from app.engine.inertial.disturbance import Calm, disturbed, shifts
from app.engine.inertial.events import Moments, StepEvents
from app.engine.inertial.steps import MEMORY_S, SETTLE_S, Steps, find_steps, settled_until
from app.engine.inertial.stride import MEAN_STEP_S, MEAN_SWING, step_durations, stride_length
from app.engine.inertial.wheels import Odometer
from app.engine.types import Float64Array, ImuSamples, SpeedReadings, StepCounts

FIELD_WINDOW_S = 0.16
_PAUSE_S = 0.8
_KEEP_S = MEMORY_S + SETTLE_S + _PAUSE_S
MAX_GAP_S = 1.0
"""A longer gap between segments is a time nobody watched: attitude starts anew, the tracker must allow for motion."""


@dataclass(frozen=True, slots=True)
class PedestrianState:
    """What the next segment needs of the ones before.

    Attributes
    ----------
    attitude : Attitude
    last_step_t, last_event_t : float, s
        Of the last step detected and of the last event told.
    tail : LevelledSamples
        The last two seconds.
    carrying : Carrying or None
    calm : Calm or None
    odometer : Odometer
    pedometer : Pedometer
    """

    attitude: Attitude
    last_step_t: float
    last_event_t: float
    tail: LevelledSamples
    carrying: Carrying | None = None
    calm: Calm | None = None
    odometer: Odometer = field(default_factory=Odometer)
    pedometer: Pedometer = field(default_factory=Pedometer)


def advance(
    state: PedestrianState | None,
    samples: ImuSamples,
    *,
    speed: SpeedReadings | None = None,
    steps: StepCounts | None = None,
) -> tuple[PedestrianState, StepEvents]:
    """Steps that the new samples confirm, or pieces of way where wheels tell the speed.

    A step is confirmed ``SETTLE_S`` after its peak, so the last one of a segment comes with the next segment; how a
    recording is cut does not change its steps. That holds for pieces of way too if readings come at least every
    ``SETTLE_S``. Counted steps, told where the detector misses many, belong to the segment that holds the reading.
    After a gap over ``MAX_GAP_S`` the heading starts from zero again.

    Parameters
    ----------
    state : PedestrianState or None
        None before the first segment.
    samples : ImuSamples
    speed : SpeedReadings or None
        While they last, they alone tell the way: the events are pieces of it, and steps are left out.
    steps : StepCounts or None
    """
    if state is not None and gap_before(state, samples) > 0.0:
        state = None
    odometer = (state.odometer if state else Odometer()).hear(speed)
    moving = odometer.speed(samples.t)[0] != 0.0
    levelled, attitude = level_samples(samples, state.attitude if state else None, moving=moving)
    if state is not None:
        levelled = state.tail.then(levelled)
    until = settled_until(levelled.t)
    last_step = state.last_step_t if state else -np.inf
    found = find_steps(levelled.t, levelled.vertical, after=last_step)
    pedometer = (state.pedometer if state else Pedometer()).hear(steps)
    walked, pedometer = _walked(found, last_step, pedometer, odometer, until)
    odometer, driven = odometer.drive(levelled, until)
    last = state.last_event_t if state else -np.inf
    held, calm = (state.carrying, state.calm) if state else (None, None)
    events, held, calm = _read(levelled, walked.merged(driven), last, held, calm)
    after = PedestrianState(
        attitude=attitude,
        last_step_t=float(found.t[-1]) if len(found) else last_step,
        last_event_t=float(events.t[-1]) if len(events) else last,
        tail=levelled.since(levelled.t[-1] - _KEEP_S),
        carrying=held,
        calm=calm,
        odometer=odometer,
        pedometer=pedometer,
    )
    return after, events


def gap_before(state: PedestrianState, samples: ImuSamples) -> float:
    """Seconds nobody watched before these samples; 0 when they follow within ``MAX_GAP_S``."""
    gap = float(samples.t[0]) - state.attitude.t
    return gap if gap > MAX_GAP_S else 0.0


def _walked(
    found: Steps, last: float, pedometer: Pedometer, odometer: Odometer, until: float
) -> tuple[Moments, Pedometer]:
    """Steps detected, or counted where the detector missed many; none where wheels tell the way.

    ``last`` (s) is the time of the step before.
    """
    stride = stride_length(found.swing, step_durations(found.t, last))
    on_foot = ~odometer.speed(found.t)[1]
    if odometer.speed(np.array([until]))[1].any():
        counted, pedometer = np.empty(0), Pedometer(until=until)
    else:
        pedometer, kept, counted = pedometer.compare(found.t[on_foot], until)
        on_foot[on_foot] = kept
    detected = _steps(found.t[on_foot], found.swing[on_foot], stride[on_foot])
    swing = np.full(counted.shape, MEAN_SWING)
    usual = stride_length(swing, np.full(counted.shape, MEAN_STEP_S))
    return detected.merged(_steps(counted, swing, usual)), pedometer


def _steps(t: Float64Array, swing: Float64Array, stride: Float64Array) -> Moments:
    return Moments(t, swing, stride, np.zeros(t.shape, dtype=bool), np.full(t.shape, np.nan))


def _read(
    levelled: LevelledSamples, moments: Moments, last: float, held: Carrying | None, calm: Calm | None
) -> tuple[StepEvents, Carrying | None, Calm | None]:
    """Heading, field and flags of steps and pieces of way; ``last`` (s) is the time of the event before."""
    t = moments.t
    begin = np.maximum(np.concatenate(([last], t[:-1])), t - _PAUSE_S)[: len(t)]
    device = window_means(levelled.t, levelled.heading[:, None], begin, t)[:, 0]
    mag = window_means(levelled.t, levelled.mag, t - FIELD_WINDOW_S, t + FIELD_WINDOW_S)
    held, walking, changed = follow(held, window_means(levelled.t, levelled.up, begin, t), device)
    aside = np.angle(np.exp(1j * (moments.course - device)))
    heading = np.interp(t, levelled.t, levelled.heading)
    speed = moments.stride / np.maximum(t - begin, 0.02)
    flags = disturbed(levelled, mag, begin, t + FIELD_WINDOW_S, speed)
    calm, shift = shifts(calm, mag, heading, flags)
    events = StepEvents(
        t=t,
        swing=moments.swing,
        motion_heading=walking + np.where(np.isnan(aside), 0.0, aside),
        heading=heading,
        mag=mag,
        stride=moments.stride,
        measured=moments.measured,
        disturbed=flags,
        shift=shift,
        carrying=changed,
    )
    return events, held, calm
