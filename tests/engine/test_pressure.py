"""Changes of level from a barometer."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from app.engine.inertial.pressure import Barometer, climbed, heights, storeys
from app.engine.types import Float64Array, PressureReadings

T0 = 1_700_000_000.0
HPA_PER_M = 0.1138


def readings(
    climb_m: Float64Array, *, seconds: Float64Array, hz: float = 5.0, drift_hpa_h: float = 0.0, noise_hpa: float = 0.02
) -> PressureReadings:
    """A barometer at 950 hPa whose height runs through ``climb_m`` at ``seconds``."""
    t = np.arange(0.0, seconds[-1], 1.0 / hz)
    hpa = 950.0 - HPA_PER_M * np.interp(t, seconds, climb_m) + drift_hpa_h * t / 3600.0
    return PressureReadings(T0 + t, hpa + noise_hpa * np.random.default_rng(0).standard_normal(len(t)))


def stairs(metres: float, *, seconds: float = 20.0, **options: float) -> PressureReadings:
    """Two minutes on a level, a climb, two minutes on the other."""
    return readings(
        np.array([0.0, 0.0, metres, metres]),
        seconds=np.array([0.0, 120.0, 120.0 + seconds, 240.0 + seconds]),
        **options,
    )


def hear(pressure: PressureReadings, seconds: float = 5.0) -> list[Barometer]:
    """The barometer after each segment."""
    heard, barometer = [], Barometer()
    for begin in np.arange(T0, pressure.t[-1] + seconds, seconds):
        own = (pressure.t > begin - seconds) & (pressure.t <= begin)
        barometer = barometer.hear(PressureReadings(pressure.t[own], pressure.hpa[own]))
        heard.append(barometer)
    return heard


def test_heights_are_those_of_the_standard_atmosphere() -> None:
    """ISO 2533: 1013.25, 898.75 and 794.95 hPa at 0, 1000 and 2000 m."""
    np.testing.assert_allclose(heights(np.array([1013.25, 898.75, 794.95])), [0.0, 1000.0, 2000.0], atol=0.5)


@pytest.mark.parametrize(("metres", "count"), [(4.0, 1), (-5.0, -1), (3.0, 1), (8.5, 2), (-12.6, -3)])
def test_a_storey_is_told_once_it_is_reached(metres: float, count: int) -> None:
    heard = hear(stairs(metres))
    assert any(b.climbing for b in heard)
    assert not heard[-1].climbing
    assert heard[-1].elsewhere
    assert heard[-1].climb_m == pytest.approx(metres, abs=0.5)
    assert storeys(heard[-1].climb_m) == count


def test_it_is_told_in_time() -> None:
    """While still on the stairs, and half a minute after them at the latest."""
    heard = hear(stairs(4.5, seconds=25.0))
    first = next(i for i, b in enumerate(heard) if b.climbing)
    reached = next(i for i, b in enumerate(heard) if b.elsewhere)
    assert 120.0 < 5.0 * first < 145.0
    assert 5.0 * reached < 175.0


@pytest.mark.parametrize("drift_hpa_h", [-3.0, 3.0])
def test_weather_is_no_climb(drift_hpa_h: float) -> None:
    quiet = readings(np.zeros(2), seconds=np.array([0.0, 3600.0]), hz=1.0, drift_hpa_h=drift_hpa_h)
    assert not any(b.climbing or b.elsewhere for b in hear(quiet, 20.0))
    assert hear(stairs(4.0, drift_hpa_h=drift_hpa_h))[-1].climb_m == pytest.approx(4.0, abs=0.8)


@pytest.mark.parametrize("metres", [1.2, -1.5])
def test_half_a_landing_is_no_level(metres: float) -> None:
    assert not any(b.climbing for b in hear(stairs(metres)))


def test_a_door_or_a_gust_is_no_climb() -> None:
    """Half a hectopascal (4 m) for two seconds."""
    pressure = readings(np.zeros(2), seconds=np.array([0.0, 120.0]))
    gust = np.abs(pressure.t - T0 - 60.0) < 1.0
    pressure.hpa[gust] += 0.5
    assert not any(b.climbing for b in hear(pressure))


def test_who_turns_back_is_where_he_was() -> None:
    to_and_fro = readings(np.array([0.0, 0.0, 3.5, 0.0, 0.0]), seconds=np.array([0.0, 60.0, 75.0, 90.0, 180.0]))
    heard = hear(to_and_fro)
    assert any(b.climbing for b in heard)
    assert not heard[-1].climbing
    assert not heard[-1].elsewhere


def test_up_and_down_again_cancel() -> None:
    there_and_back = readings(
        np.array([0.0, 0.0, 4.0, 4.0, 0.0, 0.0]), seconds=np.array([0.0, 60.0, 80.0, 180.0, 200.0, 300.0])
    )
    heard = hear(there_and_back)
    assert any(b.elsewhere for b in heard)
    assert not heard[-1].elsewhere


@settings(max_examples=20, deadline=None)
@given(seconds=st.floats(0.5, 40.0))
def test_cutting_changes_nothing(seconds: float) -> None:
    pressure = stairs(4.0)
    whole, pieces = Barometer().hear(pressure), hear(pressure, seconds)[-1]
    assert (pieces.blocks, pieces.left_m, pieces.climb_m) == (whole.blocks, whole.left_m, whole.climb_m)


def test_readings_sent_twice_count_once_and_none_change_nothing() -> None:
    pressure = stairs(4.0)
    once = Barometer().hear(pressure)
    again = once.hear(pressure)
    assert (again.blocks, again.climb_m) == (once.blocks, once.climb_m)
    assert once.hear(None) is once
    empty = PressureReadings(np.empty(0), np.empty(0))
    assert Barometer().hear(empty).blocks == ()


def test_climbed_over_a_window() -> None:
    pressure = stairs(4.0, seconds=20.0)
    half_way = PressureReadings(pressure.t[: 5 * 130], pressure.hpa[: 5 * 130])
    assert climbed(half_way) == pytest.approx(2.0, abs=0.4)
    assert climbed(pressure) == pytest.approx(0.0, abs=0.2)
    assert climbed(pressure, 200.0) == pytest.approx(4.0, abs=0.4)
    assert climbed(PressureReadings(np.ones(1), np.ones(1))) == 0.0


@pytest.mark.parametrize(("metres", "count"), [(0.0, 0), (1.9, 0), (-1.9, 0), (2.1, 1), (-2.1, -1)])
def test_what_left_the_level_is_a_storey_at_least(metres: float, count: int) -> None:
    assert storeys(metres) == count
