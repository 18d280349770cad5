"""The reader of the ``uji`` folder format, and the sensors it makes of attitude and linear acceleration."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from app.engine.inertial import detect_steps, level_samples
from app.evaluation.datasets.uji import COMPASS_PULL, GRAVITY, TEST, TRAIN, Uji, attitude, open_uji, reconstruct
from app.evaluation.errors import DataSetError
from app.evaluation.truth import truth_at_steps
from tests.evaluation.halls import TRACK, laboratory, write_uji

T_MS = 100.0 * np.arange(100)


def repeated(values: np.ndarray) -> np.ndarray:
    """As at 5 Hz: every second row repeats the one before."""
    return values[np.arange(len(values)) // 2 * 2]


def still(angles: tuple[float, float, float], *, wiggle: float = 0.01) -> np.ndarray:
    """A phone that hardly moves (a sensor that never changes is a dead one)."""
    rng = np.random.default_rng(0)
    return repeated(np.array(angles) + wiggle * rng.standard_normal((len(T_MS), 3)))


def fields() -> np.ndarray:
    return repeated(np.array([0.0, 20.0, -40.0]) + 0.1 * np.random.default_rng(1).standard_normal((len(T_MS), 3)))


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Uji:
    folder = tmp_path_factory.mktemp("data")
    write_uji(folder / "uji", laboratory())
    return open_uji(folder)


@pytest.mark.parametrize(
    ("angles", "up"),
    [
        ((0.0, 0.0, 0.0), (0.0, 0.0, 1.0)),
        ((77.0, -30.0, 0.0), (0.0, 0.5, np.sqrt(0.75))),  # top edge raised
        ((0.0, 0.0, 30.0), (-0.5, 0.0, np.sqrt(0.75))),  # left edge raised
    ],
)
def test_the_accelerometer_feels_gravity(angles: tuple[float, float, float], up: tuple[float, float, float]) -> None:
    samples = reconstruct(T_MS, fields(), np.zeros((100, 3)), still(angles), 0)
    assert samples is not None
    np.testing.assert_allclose(samples.acc.mean(axis=0), GRAVITY * np.array(up), atol=0.02)


def test_linear_acceleration_is_kept() -> None:
    linear = np.random.default_rng(2).standard_normal((100, 3))
    samples = reconstruct(T_MS, fields(), linear, still((10.0, 0.0, 0.0), wiggle=1e-6), 0)
    assert samples is not None
    np.testing.assert_allclose(samples.acc - [0.0, 0.0, GRAVITY], linear[-len(samples) :], atol=1e-3)


@given(
    rate=st.floats(-120.0, 120.0), pitch=st.floats(-60.0, 60.0), roll=st.floats(-30.0, 30.0), start=st.floats(-180, 180)
)
def test_the_gyroscope_turns_against_the_azimuth(rate: float, pitch: float, roll: float, start: float) -> None:
    """Azimuth grows clockwise, the level frame's heading counter-clockwise; wraps do not matter."""
    azimuth = (start + rate * T_MS / 1000.0 + 180.0) % 360.0 - 180.0
    angles = np.stack([azimuth, np.full(100, pitch), np.full(100, roll)], axis=1)
    angles[:, 1] += 1e-3 * np.arange(100) % 2  # alive even when the rate is zero
    samples = reconstruct(T_MS, fields(), np.zeros((100, 3)), repeated(angles), 0, compass_pull=0.0)
    assert samples is not None
    up = attitude(np.array([[start, pitch, roll]])).inv().apply([0.0, 0.0, 1.0])[0]
    turned = (samples.gyro[1:-1] @ up * 0.1).sum()
    expected = -np.radians(rate) * 0.1 * (len(samples) - 2)
    assert turned == pytest.approx(expected, abs=abs(np.radians(rate)) * 0.11 + 1e-3)


def test_the_engine_finds_the_attitude_again() -> None:
    """Levelled samples turn and tilt as the recorded attitude does."""
    t = T_MS / 1000.0
    angles = np.stack([40.0 * np.sin(t / 3), -30.0 + 3.0 * np.sin(t), 5.0 * np.cos(t)], axis=1)
    field_n = np.array([5.0, 25.0, -35.0])
    mag = attitude(repeated(angles)).inv().apply(field_n)
    samples = reconstruct(T_MS, mag, np.zeros((100, 3)), repeated(angles), 0, compass_pull=0.0)
    assert samples is not None
    levelled, _ = level_samples(samples)
    # the field is as old as the attitude it came with: up to 0.1 s against the interpolated one
    assert np.abs(levelled.mag[:, 2] - field_n[2]).max() < 2.0
    turned = np.degrees(levelled.heading - levelled.heading[0])
    np.testing.assert_allclose(turned, -(angles[-len(t) + 2 :, 0] - angles[2, 0])[: len(turned)], atol=5.0)


@given(bent=st.floats(-1.2, 1.2), pitch=st.floats(-60.0, 60.0))
def test_what_the_compass_drew_is_no_turn(bent: float, pitch: float) -> None:
    """A phone that points one way while its filter draws the azimuth to a bent field: the gyroscope feels no turn."""
    heading = np.zeros(100)
    for i in range(1, 100):
        east = 25.0 * np.sin(bent + heading[i - 1])  # of the field in the attitude believed so far, clockwise angles
        heading[i] = heading[i - 1] - COMPASS_PULL * east * 0.1
    angles = np.stack([np.degrees(heading), np.full(100, pitch), np.zeros(100)], axis=1)
    angles[:, 1] += 1e-3 * np.arange(100) % 2
    true = attitude(np.array([[0.0, pitch, 0.0]]))
    mag = true.inv().apply([25.0 * np.sin(bent), 25.0 * np.cos(bent), -35.0]) + 1e-3 * np.arange(100)[:, None] % 2
    samples = reconstruct(T_MS, mag, np.zeros((100, 3)), angles, 0)
    assert samples is not None
    turned = float(((samples.gyro @ true.inv().apply([0.0, 0.0, 1.0])[0])[1:] * np.diff(samples.t)).sum())
    assert abs(turned) < 0.02 + 0.02 * abs(heading[-1])


def test_android_angles() -> None:
    """Azimuth 90: the top edge points east. Pitch -90: it points up."""
    np.testing.assert_allclose(attitude(np.array([[90.0, 0, 0]])).apply([0, 1, 0]), [[1, 0, 0]], atol=1e-12)
    np.testing.assert_allclose(attitude(np.array([[33.0, -90, 0]])).apply([0, 1, 0]), [[0, 0, 1]], atol=1e-12)
    c_nb = attitude(np.array([[20.0, -35.0, 12.0]])).as_matrix()[0]
    angles = (np.arctan2(c_nb[0, 1], c_nb[1, 1]), np.arcsin(-c_nb[2, 1]), np.arctan2(-c_nb[2, 0], c_nb[2, 2]))
    np.testing.assert_allclose(np.degrees(angles), [20.0, -35.0, 12.0])


def test_stale_rows_are_left_out() -> None:
    angles, mag = still((40.0, -30.0, 0.0)), fields()
    angles[:5], mag[:3] = 0.0, [95.0, 6.0, 85.0]
    samples = reconstruct(T_MS, mag, np.zeros((100, 3)), angles, 1000, compass_pull=0.0)
    assert samples is not None
    assert samples.t[0] == pytest.approx(1.5)
    assert np.abs(samples.mag[:, 0]).max() < 1.0
    assert np.linalg.norm(samples.gyro, axis=1).max() < 0.1


def test_a_dead_sensor_gives_no_walk() -> None:
    frozen = np.tile([34.9, -30.2, -3.9], (100, 1))
    assert reconstruct(T_MS, fields(), np.zeros((100, 3)), frozen, 0) is None
    assert reconstruct(T_MS, np.tile([1.0, 2.0, 3.0], (100, 1)), np.zeros((100, 3)), still((0, 0, 0)), 0) is None


def test_walks_by_split(data: Uji) -> None:
    assert len(data.walks(*TRAIN)) == 19
    (walk,) = data.walks(TEST)
    assert walk.even_pace
    np.testing.assert_allclose(np.stack([walk.waypoints.x, walk.waypoints.y], axis=1), TRACK, atol=0.15)
    assert 0.0 < walk.samples.t[0] - walk.waypoints.t[0] <= 0.5
    assert np.isfinite(np.hstack([walk.samples.mag, walk.samples.acc, walk.samples.gyro])).all()


def test_truth_runs_linearly_in_time(data: Uji) -> None:
    (walk,) = data.walks(TEST)
    steps = detect_steps(walk.samples)
    steps = steps[(steps < steps[10]) | (steps > steps[14])]  # a pause that the source does not know of
    truth = truth_at_steps(steps, walk.waypoints, even_pace=True)
    np.testing.assert_allclose(truth.x, np.interp(truth.t, walk.waypoints.t, walk.waypoints.x), atol=1e-9)
    assert np.abs(truth_at_steps(steps, walk.waypoints).x - truth.x).max() > 0.5


def test_the_walker_is_felt(data: Uji) -> None:
    (walk,) = data.walks(TEST)
    assert len(detect_steps(walk.samples)) == pytest.approx(1.8 * (walk.samples.t[-1] - walk.samples.t[0]), abs=2)


def test_what_is_wrong_is_named(tmp_path: Path) -> None:
    with pytest.raises(DataSetError, match=r"uji/samples\.parquet"):
        open_uji(tmp_path)
    write_uji(tmp_path / "uji", laboratory()[:1])
    path = tmp_path / "uji" / "samples.parquet"
    pq.write_table(pq.read_table(path).drop_columns(["roll"]), path)
    with pytest.raises(DataSetError, match="lacks the columns roll"):
        open_uji(tmp_path).walks(TEST)


def test_attitude_is_a_rotation() -> None:
    assert isinstance(attitude(np.zeros((1, 3))), Rotation)
    np.testing.assert_allclose(attitude(np.zeros((1, 3))).as_matrix()[0], np.eye(3), atol=1e-12)
