"""Way from speed readings: pieces of way in place of steps."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from app.engine.inertial import StepEvents, advance
from app.engine.inertial.wheels import HOLD_S, PIECE_M, Odometer
from app.engine.localization import codec
from app.engine.types import Float64Array, ImuSamples, SpeedReadings
from tests.support.motion import drive_through
from tests.support.walks import CADENCE_HZ, STRIDE_M, Field, cut, walk_through

FIELD = Field.random(np.random.default_rng(1))
CORNERS = np.array([[0.0, 0.0], [15.0, 0.0], [15.0, 10.0]])
ROBOT, WHEELS = drive_through(CORNERS, FIELD, np.random.default_rng(5))


def within(readings: SpeedReadings, piece: ImuSamples, before: ImuSamples | None) -> SpeedReadings:
    """Readings that a client sends with a piece: those since the last sample of the piece before."""
    since = -np.inf if before is None else before.t[-1]
    own = (readings.t > since) & (readings.t <= piece.t[-1])
    return SpeedReadings(readings.t[own], readings.speed[own])


def drive(samples: ImuSamples, speed: SpeedReadings, seconds: float) -> list[StepEvents]:
    """Events segment by segment, the state as bytes in between."""
    state, before, events = None, None, []
    for piece in cut(samples, seconds=seconds):
        state, some = advance(state, piece, speed=within(speed, piece, before))
        state = codec.pedestrian_state(codec.unpack(codec.pack(codec.pedestrian_values(state))))
        before = piece
        events.append(some)
    return events


def end_of(events: StepEvents, start_heading: float) -> Float64Array:
    """Displacement by strides and headings."""
    angle = events.motion_heading + start_heading
    return np.array([np.sum(events.stride * np.cos(angle)), np.sum(events.stride * np.sin(angle))])


def test_a_robot_without_steps_goes_its_way() -> None:
    assert len(advance(None, ROBOT.samples)[1]) == 0
    _, events = advance(None, ROBOT.samples, speed=WHEELS)
    assert events.measured.all()
    assert len(events) == pytest.approx(25.0 / PIECE_M, abs=2)
    assert np.median(events.stride) == pytest.approx(PIECE_M, abs=0.03)
    assert events.stride.max() < PIECE_M + 0.03
    truth = ROBOT.at(float(events.t[-1]))
    np.testing.assert_allclose(end_of(events, ROBOT.heading[0]), truth, atol=0.4)
    assert not events.disturbed.any()
    assert not events.carrying.any()


def test_the_field_of_a_piece_is_that_at_its_end() -> None:
    _, events = advance(None, ROBOT.samples, speed=WHEELS)
    places = np.array([ROBOT.at(t) for t in events.t])
    np.testing.assert_allclose(events.mag[:, 2], FIELD.at(places)[:, 2], atol=1.0)


@settings(max_examples=20, deadline=None)
@given(seconds=st.floats(0.6, 9.0))
def test_cutting_a_recording_does_not_change_its_pieces(seconds: float) -> None:
    pieces = drive(ROBOT.samples, WHEELS, seconds)
    _, whole = advance(None, ROBOT.samples, speed=WHEELS)
    for name in ("t", "stride", "motion_heading", "heading", "mag"):
        np.testing.assert_allclose(np.concatenate([getattr(p, name) for p in pieces]), getattr(whole, name), atol=1e-6)


def test_backwards_is_opposite_to_the_heading() -> None:
    speed = SpeedReadings(WHEELS.t, -WHEELS.speed)
    _, forward = advance(None, ROBOT.samples, speed=WHEELS)
    _, back = advance(None, ROBOT.samples, speed=speed)
    np.testing.assert_allclose(back.stride, forward.stride)
    np.testing.assert_allclose(end_of(back, 0.0), -end_of(forward, 0.0), atol=1e-6)
    np.testing.assert_allclose(back.heading, forward.heading)


def test_going_to_and_fro_ends_where_it_began() -> None:
    speed = SpeedReadings(WHEELS.t, np.where((WHEELS.t - WHEELS.t[0]) % 2.0 < 1.0, 0.5, -0.5))
    straight, _ = drive_through(np.array([[0.0, 0.0], [25.0, 0.0]]), FIELD, np.random.default_rng(5))
    _, events = advance(None, straight.samples, speed=speed)
    assert np.linalg.norm(end_of(events, 0.0)) < 0.6


def test_wheels_at_rest_make_no_events() -> None:
    noise = 0.01 * np.random.default_rng(0).standard_normal(WHEELS.t.shape)
    _, events = advance(None, ROBOT.samples, speed=SpeedReadings(WHEELS.t, noise))
    assert len(events) == 0


def test_fast_vehicles_have_three_pieces_a_second() -> None:
    car, speed = drive_through(np.array([[0.0, 0.0], [400.0, 0.0]]), FIELD, np.random.default_rng(5), speed_m_s=15.0)
    _, events = advance(None, car.samples, speed=speed)
    assert np.diff(events.t).min() >= 0.33
    assert events.stride.sum() == pytest.approx(15.0 * (events.t[-1] - events.t[0]), rel=0.03)


def test_who_leaves_the_trolley_is_followed_by_steps() -> None:
    """Readings end half-way: wheels tell the way before, steps after."""
    walk = walk_through(np.array([[0.0, 0.0], [40.0, 0.0]]), FIELD, np.random.default_rng(5))
    half = walk.samples.t[0] + 15.0
    t = np.arange(walk.samples.t[0], half, 0.1)
    _, events = advance(None, walk.samples, speed=SpeedReadings(t, np.full(t.shape, STRIDE_M * CADENCE_HZ)))
    assert events.measured[events.t < half].all()
    assert not events.measured[events.t > half + HOLD_S + 0.1].any()
    assert (np.diff(events.t) > 0.0).all()
    assert np.diff(events.t).max() < 1.1
    assert events.stride.sum() == pytest.approx(40.0, rel=0.08)


def test_speed_between_readings() -> None:
    wheels = Odometer().hear(SpeedReadings(np.array([10.0, 11.0, 20.0]), np.array([1.0, 2.0, 3.0])))
    speed, covered = wheels.speed(np.array([9.9, 10.5, 12.5, 14.0, 21.9, 22.1]))
    np.testing.assert_allclose(speed, [0.0, 1.5, 2.0, 0.0, 3.0, 0.0])
    assert covered.tolist() == [False, True, True, False, True, False]


def test_readings_sent_twice_count_once() -> None:
    once = Odometer().hear(WHEELS)
    np.testing.assert_array_equal(once.hear(WHEELS).readings.t, WHEELS.t)
    assert once.hear(None) is once


@pytest.mark.parametrize("hz", [0.6, 1.0, 2.0, 10.0])
def test_sparse_readings_give_the_whole_way(hz: float) -> None:
    t = np.arange(ROBOT.samples.t[0], ROBOT.samples.t[-1], 1.0 / hz)
    pieces = drive(ROBOT.samples, SpeedReadings(t, np.full(t.shape, 1.0)), 5.0)
    assert sum(p.stride.sum() for p in pieces) == pytest.approx(25.0, abs=1.0)
