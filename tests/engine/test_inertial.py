"""Tilt, heading, steps and placement on simulated walks."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from app.engine.errors import InputError
from app.engine.inertial import advance, common_time_base, detect_steps, find_steps, level_samples
from app.engine.inertial.legs import heading_offset, positions_by_steps, step_count, stride_scale
from app.engine.inertial.steps import Steps
from app.engine.inertial.stride import MEAN_STEP_S, step_durations, stride_length
from app.engine.types import ImuSamples, Waypoints
from tests.support.walks import CADENCE_HZ, Field, SimulatedWalk, cut, walk_through

FIELD = Field.random(np.random.default_rng(1))
WALK = walk_through(np.array([[0.0, 0.0], [15.0, 0.0], [15.0, 10.0]]), FIELD, np.random.default_rng(5))


def test_heading_follows_the_walk(walk: SimulatedWalk) -> None:
    levelled, _ = level_samples(walk.samples)
    turned = walk.heading - walk.heading[0]
    np.testing.assert_allclose(levelled.heading, turned, atol=0.05)


def test_the_levelled_field_is_the_field(walk: SimulatedWalk, field: Field) -> None:
    levelled, _ = level_samples(walk.samples)
    up = field.at(walk.xy)[:, 2]
    assert np.sqrt(np.mean((levelled.mag[:, 2] - up) ** 2)) < 1.0  # sensor noise 0.3 uT, and gait's tilt


def test_tilt_of_the_phone_does_not_matter(walk: SimulatedWalk) -> None:
    """A phone held 40 degrees up gives the same levelled field and heading."""
    a = np.radians(40.0)
    tilt = np.array([[1, 0, 0], [0, np.cos(a), np.sin(a)], [0, -np.sin(a), np.cos(a)]])
    s = walk.samples
    tilted = ImuSamples(s.t, s.mag @ tilt.T, s.acc @ tilt.T, s.gyro @ tilt.T)
    flat, _ = level_samples(s)
    other, _ = level_samples(tilted)
    np.testing.assert_allclose(other.mag, flat.mag, atol=0.1)
    np.testing.assert_allclose(other.heading, flat.heading, atol=0.02)


def test_step_rate_is_the_walkers(walk: SimulatedWalk) -> None:
    steps = detect_steps(walk.samples)
    duration = walk.samples.t[-1] - walk.samples.t[0]
    assert len(steps) == pytest.approx(CADENCE_HZ * duration, abs=2)


@settings(max_examples=25, deadline=None)
@given(seconds=st.floats(0.35, 9.0))
def test_cutting_a_recording_does_not_change_its_steps(seconds: float) -> None:
    state, pieces = None, []
    for samples in cut(WALK.samples, seconds=seconds):
        state, events = advance(state, samples)
        pieces.append(events)
    _, whole = advance(None, WALK.samples)
    np.testing.assert_array_equal(np.concatenate([p.t for p in pieces]), whole.t)
    np.testing.assert_allclose(np.concatenate([p.mag for p in pieces]), whole.mag, atol=1e-9)
    np.testing.assert_allclose(np.concatenate([p.heading for p in pieces]), whole.heading, atol=1e-9)
    np.testing.assert_allclose(np.concatenate([p.motion_heading for p in pieces]), whole.motion_heading, atol=1e-9)


@settings(max_examples=50, deadline=None)
@given(times=st.lists(st.floats(0, 60), min_size=0, max_size=40, unique=True))
def test_step_count_never_falls_and_counts_every_step(times: list[float]) -> None:
    steps = Steps(np.sort(times), np.ones(len(times)))
    t = np.linspace(-5, 70, 300)
    count = step_count(t, steps)
    assert (np.diff(count) >= -1e-9).all()
    assert count[0] == 0
    assert count[-1] == pytest.approx(len(times))


def coarse(samples: ImuSamples, every: int) -> ImuSamples:
    """Every so many samples of the field and the force, and the mean rate between them."""
    turned = np.cumsum(samples.gyro, axis=0)[::every]
    gyro = np.diff(turned, axis=0, prepend=turned[:1]) / every
    return ImuSamples(samples.t[::every], samples.mag[::every], samples.acc[::every], gyro)


@pytest.mark.parametrize("every", [3, 5], ids=["17 Hz", "10 Hz"])
class TestCoarseRates:
    def test_steps_are_those_of_fifty_hertz(self, every: int) -> None:
        fine, _ = level_samples(WALK.samples)
        levelled, _ = level_samples(coarse(WALK.samples, every))
        expected, found = find_steps(fine.t, fine.vertical), find_steps(levelled.t, levelled.vertical)
        assert len(found) == pytest.approx(len(expected), abs=1)
        nearest = np.abs(found.t[:, None] - expected.t).min(axis=1)
        assert np.median(nearest) < 0.05
        assert np.median(found.swing) == pytest.approx(np.median(expected.swing), rel=0.06)

    @pytest.mark.parametrize("seconds", [1.1, 1.3, 1.7, 3.1])
    def test_cutting_changes_nothing(self, every: int, seconds: float) -> None:
        samples = coarse(WALK.samples, every)
        state, pieces = None, []
        for piece in cut(samples, seconds=seconds):
            state, events = advance(state, piece)
            pieces.append(events)
        _, whole = advance(None, samples)
        np.testing.assert_array_equal(np.concatenate([p.t for p in pieces]), whole.t)
        np.testing.assert_allclose(np.concatenate([p.swing for p in pieces]), whole.swing, atol=1e-9)

    def test_a_gentle_walker_is_felt_and_standing_is_not(self, every: int) -> None:
        t = 1_700_000_000.0 + np.arange(0.0, 30.0, 0.02 * every)
        noise = 0.1 * np.random.default_rng(0).standard_normal(len(t))
        walking = find_steps(t, 9.81 + 0.75 * np.sin(2 * np.pi * 1.4 * t) + noise)
        assert len(walking) == pytest.approx(1.4 * 30.0, abs=3)
        assert len(find_steps(t, 9.81 + noise)) == 0


def test_too_few_coarse_samples_have_no_steps() -> None:
    for n in range(7):
        t = 0.1 * np.arange(n)
        assert len(find_steps(t, 9.81 + np.sin(9.0 * t))) == 0


def test_a_pause_does_not_move_the_walker() -> None:
    steps = Steps(np.array([1.0, 1.5, 2.0, 10.0, 10.5, 11.0]), np.ones(6))
    waypoints = Waypoints(np.array([0.5, 11.0]), np.array([0.0, 5.5]), np.array([0.0, 0.0]))
    x, _ = positions_by_steps(np.array([2.5, 6.0, 9.0]), steps, waypoints)
    assert np.ptp(x) == pytest.approx(0.0)


def test_positions_outside_the_waypoints_are_unknown() -> None:
    waypoints = Waypoints(np.array([1.0, 2.0]), np.array([0.0, 1.0]), np.array([0.0, 1.0]))
    x, y = positions_by_steps(np.array([0.0, 1.5, 3.0]), Steps(np.empty(0), np.empty(0)), waypoints)
    assert np.isnan(x[[0, 2]]).all()
    assert (x[1], y[1]) == (0.5, 0.5)


def test_stride_scale_is_known_distance_over_modelled(walk: SimulatedWalk) -> None:
    levelled, _ = level_samples(walk.samples)
    steps = find_steps(levelled.t, levelled.vertical)
    t = np.linspace(walk.samples.t[0], walk.samples.t[-1], 40)
    x, y = np.array([walk.at(at) for at in t]).T
    scale = stride_scale(steps, float(levelled.t[-1]), Waypoints(t, x, y))
    events = advance(None, walk.samples)[1]
    length = np.hypot(np.diff(x), np.diff(y)).sum()
    assert scale == pytest.approx(length / events.stride.sum(), rel=0.06)
    assert scale is not None
    assert stride_scale(steps, float(levelled.t[-1]), Waypoints(t, 1.3 * x, 1.3 * y)) == pytest.approx(1.3 * scale)


def test_stride_scale_is_not_told_by_few_steps_or_wrong_labels() -> None:
    steps = Steps(np.arange(1.0, 10.0, 0.5), np.full(18, 6.4))
    ends = np.array([0.8, 9.7])
    assert stride_scale(steps, 20.0, Waypoints(ends, np.array([0.0, 12.0]), np.zeros(2))) is not None
    assert stride_scale(steps, 20.0, Waypoints(ends, np.array([0.0, 60.0]), np.zeros(2))) is None
    assert stride_scale(steps, 20.0, Waypoints(np.array([0.8, 3.0]), np.array([0.0, 3.0]), np.zeros(2))) is None


def test_steps_too_late_to_be_found_do_not_stretch_the_stride() -> None:
    """Twenty steps of 0.7 m, the recording ends with the last: it and the one before are not confirmed."""
    t = np.arange(1, 21) * 0.5
    waypoints = Waypoints(np.array([0.0, 10.0]), np.array([0.0, 14.0]), np.zeros(2))
    whole = stride_scale(Steps(t, np.full(20, 6.4)), 12.0, waypoints)
    cut_off = stride_scale(Steps(t[:-1], np.full(19, 6.4)), 10.0, waypoints)
    assert cut_off == pytest.approx(whole, rel=0.025)


def test_heading_offset_finds_the_level_frame(walk: SimulatedWalk) -> None:
    levelled, _ = level_samples(walk.samples)
    steps = find_steps(levelled.t, levelled.vertical)
    t = np.arange(walk.samples.t[0], walk.samples.t[-1], 5.0)
    xy = np.array([walk.at(at) for at in t])
    offset = heading_offset(levelled, steps, Waypoints(t, xy[:, 0], xy[:, 1]))
    error = np.angle(np.exp(1j * (levelled.heading + offset - walk.heading)))
    assert np.abs(error).max() < 0.15


@given(swing=st.floats(0, 200), duration=st.floats(0.33, np.inf))
def test_stride_is_human(swing: float, duration: float) -> None:
    assert 0.3 <= stride_length(np.array([swing]), np.array([duration]))[0] <= 1.1


def test_the_median_step_is_a_stride_of_two_feet() -> None:
    assert stride_length(np.array([6.4]), np.array([MEAN_STEP_S]))[0] == pytest.approx(0.68, abs=0.01)


@given(bounce=st.floats(0.5, 4.0), duration=st.floats(0.35, 0.9))
def test_the_same_bounce_is_the_same_stride_at_any_pace(bounce: float, duration: float) -> None:
    """A slow walker's acceleration is weak, his steps are not short."""
    slow, usual = stride_length(bounce / np.array([duration, MEAN_STEP_S]) ** 2, np.array([duration, MEAN_STEP_S]))
    assert slow == pytest.approx(usual, rel=1e-9)


def test_a_step_after_a_pause_is_a_usual_one() -> None:
    durations = step_durations(np.array([0.5, 1.0, 9.0]), -np.inf)
    np.testing.assert_array_equal(durations, [np.inf, 0.5, 8.0])
    strides = stride_length(np.full(3, 6.4), durations)
    assert strides[0] == strides[2] == stride_length(np.array([6.4]), np.array([MEAN_STEP_S]))[0]
    assert len(step_durations(np.empty(0), 1.0)) == 0


class TestCommonTimeBase:
    T = np.arange(0.0, 2.0, 0.02)

    def test_streams_meet_on_the_magnetometers_times(self) -> None:
        acc_t, gyro_t = np.arange(0.1, 2.0, 0.005), np.arange(-0.3, 1.7, 0.011)
        line = np.stack([np.sin(acc_t), acc_t, 1 + 0 * acc_t], axis=1)
        rates = np.stack([gyro_t] * 3, axis=1)
        mag = np.random.default_rng(0).standard_normal((len(self.T), 3))
        merged = common_time_base(self.T, mag, acc_t, line, gyro_t, rates)
        assert merged.t[0] >= 0.1
        assert merged.t[-1] <= 1.7
        np.testing.assert_array_equal(merged.mag, mag[np.isin(self.T, merged.t)])
        np.testing.assert_allclose(merged.acc[:, 1], merged.t)
        np.testing.assert_allclose(merged.acc[:, 0], np.sin(merged.t), atol=1e-4)
        np.testing.assert_allclose(merged.gyro[:, 2], merged.t)

    @pytest.mark.parametrize(
        ("acc_t", "field"),
        [(T[::-1], "acc.t"), (T[:1], "acc.t"), (np.append(T, 9.0), "acc.t"), (T + 100.0, "mag.t")],
    )
    def test_what_cannot_be_merged_is_named(self, acc_t: np.ndarray, field: str) -> None:
        zeros = np.zeros((len(self.T), 3))
        with pytest.raises(InputError) as error:
            common_time_base(self.T, zeros, acc_t, np.zeros((len(acc_t), 3)), self.T, zeros)
        assert error.value.field == field
