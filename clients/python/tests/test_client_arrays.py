"""Samples, fixes and their geometry."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import FIXES, make_samples
from hypothesis import given
from hypothesis import strategies as st
from isodyn_client import Aids, BleScans, Fixes, GnssFixes, Samples, Waypoints, WifiScans
from isodyn_client.fixes import FixColumns


@given(n=st.integers(0, 300), segment_s=st.floats(0.02, 20.0), gap_ms=st.floats(0.0, 9000.0))
def test_splitting_loses_nothing(n: int, segment_s: float, gap_ms: float) -> None:
    t_ms = 1e12 + 20.0 * np.arange(n) + np.where(np.arange(n) > n // 2, gap_ms, 0.0)
    zeros = np.zeros((n, 3))
    pieces = list(Samples(t_ms, zeros, zeros, zeros).split(segment_s))
    assert np.array_equal(np.concatenate([np.zeros(0), *(piece.t_ms for piece in pieces)]), t_ms)
    assert all(len(piece) and piece.duration_s < segment_s for piece in pieces)


def test_lists_are_taken_as_arrays() -> None:
    samples = Samples([1, 2], [[1, 2, 3]] * 2, [[0, 0, 9.8]] * 2, [[0, 0, 0]] * 2)  # type: ignore[arg-type]
    assert samples.mag.dtype == np.float64
    assert samples.duration_s == 0.001


@pytest.mark.parametrize("field", ["mag", "acc", "gyro"])
def test_a_column_of_another_length_is_named(field: str) -> None:
    columns = {"mag": np.zeros((3, 3)), "acc": np.zeros((3, 3)), "gyro": np.zeros((3, 3)), field: np.zeros((2, 3))}
    with pytest.raises(ValueError, match=f"{field} needs shape"):
        Samples(np.arange(3.0), **columns)


def test_waypoints_and_wifi_check_their_lengths() -> None:
    with pytest.raises(ValueError, match="y needs shape"):
        Waypoints(np.arange(2.0), np.arange(2.0), np.arange(3.0))
    with pytest.raises(ValueError, match="bssid"):
        WifiScans(np.arange(2.0), ["a"], np.arange(2.0))
    with pytest.raises(ValueError, match="address"):
        BleScans(np.arange(2.0), ["a", "b", "c"], np.arange(2.0))
    with pytest.raises(ValueError, match="accuracy_m needs shape"):
        GnssFixes(np.arange(2.0), np.arange(2.0), np.arange(2.0), np.arange(1.0))


def test_aids_without_rows_are_not_sent() -> None:
    nothing = WifiScans([], [], [])  # type: ignore[arg-type]
    assert Aids(wifi=nothing).names == ()
    assert Aids(wifi=nothing).columns() == {}
    assert Aids.from_columns({"seq": 0, "wifi": None, "samples": {}}).names == ()


def test_split_refuses_nonsense() -> None:
    with pytest.raises(ValueError, match="positive"):
        next(make_samples(3).split(0.0))


def fixes_with(cov_xx: float, cov_xy: float, cov_yy: float) -> Fixes:
    one = {name: values[:1] for name, values in FIXES.items()}
    columns = one | {"cov_xx": [cov_xx], "cov_xy": [cov_xy], "cov_yy": [cov_yy], "x": [0.0], "y": [0.0]}
    return Fixes.from_columns(FixColumns.model_validate(columns))


@given(major=st.floats(0.5, 20.0), ratio=st.floats(0.05, 0.95), angle=st.floats(1.0, 179.0))
def test_an_ellipse_gives_back_its_axes(major: float, ratio: float, angle: float) -> None:
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    axes = np.array([[c, -s], [s, c]])
    covariance = axes @ np.diag([major**2, (ratio * major) ** 2]) @ axes.T / 5.991464547107979
    fixes = fixes_with(covariance[0, 0], covariance[0, 1], covariance[1, 1])
    ellipse = fixes.ellipse95(0)
    assert ellipse.semi_major_m == pytest.approx(major, rel=1e-6)
    assert ellipse.semi_minor_m == pytest.approx(ratio * major, rel=1e-6)
    assert ellipse.angle_deg == pytest.approx(angle, abs=1e-4)
    tip = major * np.array([c, s])
    assert fixes.inside95(*(0.999 * tip[:, None])).all()
    assert not fixes.inside95(*(1.001 * tip[:, None])).any()


def test_95_percent_are_inside() -> None:
    fixes = fixes_with(4.0, 1.5, 2.0)
    rng = np.random.default_rng(1)
    draws = rng.multivariate_normal([0, 0], fixes.covariance[0], size=20_000)
    inside = np.mean([fixes.inside95(draws[i : i + 1, 0], draws[i : i + 1, 1])[0] for i in range(0, 20_000, 10)])
    assert inside == pytest.approx(0.95, abs=0.015)


def test_no_fixes_are_fixes_too() -> None:
    nothing = Fixes.concatenate([])
    assert len(nothing) == 0
    assert nothing.covariance.shape == (0, 2, 2)
    assert nothing.xy.shape == (0, 2)
