"""A device's own step counter against detected steps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from app.engine.inertial import StepEvents, advance
from app.engine.inertial.counter import Pedometer
from app.engine.inertial.stride import MEAN_STEP_S, MEAN_SWING, stride_length
from app.engine.localization import codec
from app.engine.types import ImuSamples, SpeedReadings, StepCounts
from tests.support.walks import CADENCE_HZ, Field, cut, walk_through

FIELD = Field.random(np.random.default_rng(1))
WALK = walk_through(np.array([[0.0, 0.0], [60.0, 0.0]]), FIELD, np.random.default_rng(5))
T0, T1 = float(WALK.samples.t[0]), float(WALK.samples.t[-1])


def counts(*, every_s: float = 2.0, lag_s: float = 0.0, first: float = 5000.0, rate: float = CADENCE_HZ) -> StepCounts:
    """A counter that reads the walk's steps of ``lag_s`` ago."""
    t = np.arange(T0, T1, every_s)
    return StepCounts(t, first + np.floor(rate * np.maximum(t - lag_s - T0, 0.0)))


def muffled(samples: ImuSamples, share: float) -> ImuSamples:
    """As in a soft pocket: what is left of the gait is too little to be a step."""
    gravity = np.array([0.0, 0.0, 9.81])
    return replace(samples, acc=gravity + share * (samples.acc - gravity))


def walk_with(samples: ImuSamples, readings: StepCounts, seconds: float = 5.0) -> StepEvents:
    state, pieces, sent = None, [], -np.inf
    for piece in cut(samples, seconds=seconds):
        own = (readings.t > sent) & (readings.t <= piece.t[-1])
        state, events = advance(state, piece, steps=StepCounts(readings.t[own], readings.count[own]))
        state = codec.pedestrian_state(codec.unpack(codec.pack(codec.pedestrian_values(state))))
        sent = piece.t[-1]
        pieces.append(events)
    return StepEvents(*(np.concatenate([getattr(p, name) for p in pieces]) for name in StepEvents.__slots__))


@pytest.mark.parametrize("lag_s", [0.0, 2.0, 5.0])
def test_where_they_agree_nothing_changes(lag_s: float) -> None:
    _, alone = advance(None, WALK.samples)
    both = walk_with(WALK.samples, counts(lag_s=lag_s))
    np.testing.assert_array_equal(both.t, alone.t)
    np.testing.assert_allclose(both.stride, alone.stride)


def test_a_lagging_counter_adds_nothing_after_the_walk() -> None:
    """Six seconds behind, it goes on counting while the walker stands."""
    n = len(WALK.samples)
    still = replace(WALK.samples, acc=np.where(np.arange(n)[:, None] < n // 2, WALK.samples.acc, [0.0, 0.0, 9.81]))
    _, alone = advance(None, still)
    t = np.arange(T0, T1, 1.0)
    walked = np.minimum(np.maximum(t - 6.0 - T0, 0.0), 0.5 * (T1 - T0))
    both = walk_with(still, StepCounts(t, np.floor(CADENCE_HZ * walked)))
    np.testing.assert_array_equal(both.t, alone.t)


@pytest.mark.parametrize("share", [0.0, 0.2], ids=["no steps found", "hardly any"])
@pytest.mark.parametrize("every_s", [0.5, 2.0, 4.0])
def test_a_soft_pocket_goes_by_the_counter(share: float, every_s: float) -> None:
    samples, readings = muffled(WALK.samples, share), counts(every_s=every_s)
    assert len(advance(None, samples)[1]) < 0.5 * CADENCE_HZ * (T1 - T0)
    events = walk_with(samples, readings)
    assert len(events) == pytest.approx(readings.count[-1] - readings.count[0], abs=10)
    assert (np.diff(events.t) > 0.0).all()
    assert np.median(np.diff(events.t)) == pytest.approx(1.0 / CADENCE_HZ, rel=0.15)
    assert not events.measured.any()
    counted = events.swing == MEAN_SWING
    assert counted.mean() > 0.9
    np.testing.assert_allclose(
        events.stride[counted], stride_length(np.array([MEAN_SWING]), np.array([MEAN_STEP_S]))[0]
    )


def test_steps_after_a_stand_are_those_just_before_the_reading() -> None:
    """A counter that speaks only when it changes: ten steps within the last ten of sixty seconds."""
    pedometer = Pedometer().hear(StepCounts(np.array([0.0, 60.0]), np.array([100.0, 110.0])))
    _, _, added = pedometer.compare(np.empty(0), 61.0)
    np.testing.assert_allclose(added, np.arange(51.0, 61.0))


@pytest.mark.parametrize("jump", [-3000.0, 1e6], ids=["set to nothing", "jumped"])
def test_a_counter_set_anew_is_begun_with_anew(jump: float) -> None:
    readings = counts()
    readings.count[len(readings.t) // 2 :] += jump
    _, alone = advance(None, WALK.samples)
    np.testing.assert_array_equal(walk_with(WALK.samples, readings).t, alone.t)
    events = walk_with(muffled(WALK.samples, 0.0), readings)
    assert len(events) == pytest.approx(CADENCE_HZ * (T1 - T0), abs=16)


def test_wheels_come_before_the_counter() -> None:
    t = np.arange(T0, T1, 0.1)
    speed = SpeedReadings(t, np.full(t.shape, 1.0))
    _, events = advance(None, muffled(WALK.samples, 0.0), speed=speed, steps=counts())
    assert events.measured.all()


def test_steps_told_already_are_not_told_again() -> None:
    """Three of eight were found and told before the reading came."""
    pedometer = Pedometer().hear(StepCounts(np.array([0.0]), np.array([0.0])))
    pedometer, _, _ = pedometer.compare(np.array([1.0, 2.0, 3.0]), 4.0)
    pedometer = pedometer.hear(StepCounts(np.array([6.0]), np.array([8.0])))
    after, kept, added = pedometer.compare(np.array([5.0, 6.5]), 7.0)
    assert kept.tolist() == [False, True]
    assert len(added) == 5
    assert (added > 4.0).all()
    assert after.told == 1.0
