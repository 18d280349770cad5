"""Fields that cannot be the building's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from app.engine.inertial import StepEvents, advance
from app.engine.types import Float64Array, ImuSamples
from tests.support.motion import dipole, drive_through
from tests.support.walks import Field, cut, walk_through

FIELD = Field.random(np.random.default_rng(1))
WALK = walk_through(np.array([[0.0, 0.0], [50.0, 0.0]]), FIELD, np.random.default_rng(5))
AT = float(WALK.samples.t[0]) + 20.0


def with_field(samples: ImuSamples, more: Float64Array) -> StepEvents:
    return advance(None, replace(samples, mag=samples.mag + more))[1]


def test_a_walk_past_steel_is_none() -> None:
    assert not advance(None, WALK.samples)[1].disturbed.any()


@pytest.mark.parametrize(("aside_m", "told"), [(1.3, True), (6.0, False)], ids=["close by", "across the road"])
def test_a_car_that_passes(aside_m: float, told: bool) -> None:
    """Moment 400 A m^2, 30 km/h. What it does six metres away is less than any column of a building does."""
    along = 8.3 * (WALK.samples.t - AT)
    away = np.stack([along, np.full(along.shape, aside_m), np.zeros(along.shape)], axis=1)
    events = with_field(WALK.samples, dipole(np.array([200.0, 300.0, 150.0]), away))
    assert events.disturbed.any() == told
    assert (np.abs(events.t[events.disturbed] - AT) < 1.5).all()


def test_a_magnet_brought_near_and_taken_away() -> None:
    """A clasp of 0.2 A m^2 comes within 5 cm for five seconds."""
    distance = 0.05 + 0.6 * np.clip(np.abs(WALK.samples.t - AT - 2.5) - 2.5, 0.0, 1.0)
    away = np.stack([distance, np.zeros(distance.shape), np.zeros(distance.shape)], axis=1)
    events = with_field(WALK.samples, dipole(np.array([0.2, 0.0, 0.0]), away))
    near = (events.t > AT) & (events.t < AT + 5.0)
    assert events.disturbed[near].all()
    assert not events.disturbed[(events.t < AT - 1.5) | (events.t > AT + 6.5)].any()


@pytest.mark.parametrize("factor", [0.05, 5.0], ids=["shielded", "saturated"])
def test_a_magnitude_beyond_any_building(factor: float) -> None:
    samples = replace(WALK.samples, mag=WALK.samples.mag * factor)
    assert advance(None, samples)[1].disturbed.all()


def test_cutting_changes_no_flag() -> None:
    more = np.zeros((len(WALK.samples), 3))
    more[WALK.samples.t > AT, 2] = -30.0
    samples = replace(WALK.samples, mag=WALK.samples.mag + more)
    whole = advance(None, samples)[1].disturbed
    assert 1 <= whole.sum() <= 3
    for seconds in (0.7, 1.3, 5.0):
        state, flags = None, []
        for piece in cut(samples, seconds=seconds):
            state, events = advance(state, piece)
            flags.append(events.disturbed)
        np.testing.assert_array_equal(np.concatenate(flags), whole)


def test_a_fast_vehicle_passes_the_same_steel_in_less_time() -> None:
    steel, path = Field.random(np.random.default_rng(1), sd=15.0), np.array([[0.0, 0.0], [300.0, 0.0]])
    assert not advance(None, walk_through(path, steel, np.random.default_rng(5)).samples)[1].disturbed.any()
    car, speed = drive_through(path, steel, np.random.default_rng(5), speed_m_s=12.0)
    assert not advance(None, car.samples, speed=speed)[1].disturbed.any()
