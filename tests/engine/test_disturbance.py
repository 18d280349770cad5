"""Fields that cannot be the building's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from app.engine.inertial import StepEvents, advance
from app.engine.inertial.disturbance import shifts
from app.engine.localization import codec
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
    samples = on_a_mount(-30.0)
    whole = advance(None, samples)[1]
    assert 1 <= whole.disturbed.sum() <= 3
    for seconds in (0.7, 1.3, 5.0):
        state, flags, shift = None, [], []
        for piece in cut(samples, seconds=seconds):
            state, events = advance(state, piece)
            state = codec.pedestrian_state(codec.unpack(codec.pack(codec.pedestrian_values(state))))
            flags.append(events.disturbed)
            shift.append(events.shift)
        np.testing.assert_array_equal(np.concatenate(flags), whole.disturbed)
        np.testing.assert_allclose(np.concatenate(shift), whole.shift, atol=1e-6)


def on_a_mount(up_ut: float) -> ImuSamples:
    """From ``AT`` on with a magnet under the phone."""
    more = np.zeros((len(WALK.samples), 3))
    more[WALK.samples.t > AT, 2] = up_ut
    return replace(WALK.samples, mag=WALK.samples.mag + more)


def test_a_magnet_that_stays_is_told_once_with_its_strength() -> None:
    events = advance(None, on_a_mount(-30.0))[1]
    last = int(np.flatnonzero(events.disturbed)[-1])
    assert np.flatnonzero(events.shift).tolist() == [last + 1]
    assert events.shift[last + 1] == pytest.approx(30.0, abs=8.0)


def test_one_that_passes_leaves_little_behind() -> None:
    heading = np.array([0.0, 0.0, 1.0, 2.0])
    level = np.exp(-1j * heading)  # 20 uT towards the walk's first direction, the walker turns
    mag = np.stack([20.0 * level.real, 20.0 * level.imag, np.full(4, -30.0)], axis=1)
    mag[1:3] += 200.0
    calm, left = shifts(None, mag, heading, np.array([False, True, True, False]))
    np.testing.assert_allclose(left, 0.0, atol=1e-9)
    assert calm is not None
    assert not calm.passing


def test_a_disturbed_start_has_nothing_to_compare_with() -> None:
    calm, left = shifts(None, np.ones((2, 3)), np.zeros(2), np.array([True, False]))
    np.testing.assert_array_equal(left, 0.0)
    assert calm is not None


def test_a_fast_vehicle_passes_the_same_steel_in_less_time() -> None:
    steel, path = Field.random(np.random.default_rng(1), sd=15.0), np.array([[0.0, 0.0], [300.0, 0.0]])
    assert not advance(None, walk_through(path, steel, np.random.default_rng(5)).samples)[1].disturbed.any()
    car, speed = drive_through(path, steel, np.random.default_rng(5), speed_m_s=12.0)
    assert not advance(None, car.samples, speed=speed)[1].disturbed.any()
