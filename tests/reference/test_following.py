"""Tracks that follow contours (`app.engine.kernels.following`) against Gaussian conditioning of all states at once."""

from __future__ import annotations

import numpy as np
import pytest

from app.engine.kernels.following import ORDER, follow, place, places
from tests.reference import contours as slow

_V, _U = np.mgrid[0:60, 0:70].astype(float)


def _planes(slope: np.ndarray, base: np.ndarray) -> np.ndarray:
    return np.stack([b + s[0] * _U + s[1] * _V for s, b in zip(slope, base, strict=True)]).astype(np.float32)


def _follow(planes, variance, away, dt, values, start, P0, growth, *, about=False, states=None, m0=None, turning=False):  # type: ignore[no-untyped-def]
    n, channels = values.shape
    states = np.zeros((n, ORDER + channels)) if states is None else states.copy()
    P = np.empty_like(P0)
    variances = np.full(planes.shape, variance, dtype=np.float32)
    m0 = np.zeros(len(P0)) if m0 is None else m0
    cost, used = follow(
        planes, variances, away, dt, values, np.zeros(n), turning, start, m0, P0, growth, 40.0, 50.0, about, states, P
    )
    return states, P, cost, used


@pytest.mark.parametrize("channels", [1, 2, 3])
@pytest.mark.parametrize("about", [False, True])
def test_over_planes_the_filter_is_exact(channels: int, about: bool) -> None:
    rng = np.random.default_rng(channels)
    n = 12
    slope, base = rng.normal(0.0, 1.0, (channels, 2)), rng.normal(0.0, 5.0, channels)
    away = np.cumsum(rng.uniform(0.0, 2.0, (n, 2)), axis=0)
    away -= away[0]
    dt, start = np.concatenate([[0.0], rng.uniform(0.02, 0.2, n - 1)]), np.array([25.0, 20.0])
    spread = np.concatenate([[1.0, 1.0], [4.0] * 2, [9.0] * 2, [0.0, 0.0], [0.3] * channels])
    P0, growth = np.diag(spread), np.array([1.5, 2.5])
    P0[0, 1] = P0[1, 0] = 0.4
    values = base + (start + away + 0.3) @ slope.T + 0.2 * rng.standard_normal((n, channels))
    expected, P, cost = slow.follow_plane(slope, base, away, dt, values, start, P0, growth, 0.04)
    reference = 0.2 * rng.standard_normal((n, ORDER + channels)) * (spread > 0.0)
    found = _follow(_planes(slope, base), 0.04, away, dt, values, start, P0, growth, about=about, states=reference)
    assert found[3] == n * channels
    np.testing.assert_allclose(found[0], expected, atol=2e-4)
    np.testing.assert_allclose(found[1], P, atol=1e-4)
    assert found[2] == pytest.approx(cost, abs=1e-2)


def test_turn_stretch_and_the_turned_vector_come_out_of_a_rough_map() -> None:
    planes = np.stack([np.sin(0.3 * _U + c) * 5 + np.cos(0.25 * _V - c) * 5 for c in range(3)]).astype(np.float32)
    n = 30
    away = np.stack([np.linspace(0, 20, n), 4 * np.sin(np.linspace(0, 3, n))], axis=1)
    truth = np.zeros((n, ORDER + 3))
    truth[:, 0], truth[:, 6], truth[:, 7] = 0.5, 0.06, 0.04
    start = np.array([20.0, 25.0])
    at = np.empty((n, 2))
    places(start, truth, away, at)
    j, i = at[:, 0].astype(int), at[:, 1].astype(int)
    u, v = at[:, 0] - j, at[:, 1] - i
    m = planes.astype(float)
    z = (
        (1 - v) * ((1 - u) * m[:, i, j] + u * m[:, i, j + 1]) + v * ((1 - u) * m[:, i + 1, j] + u * m[:, i + 1, j + 1])
    ).T
    c, s = np.cos(-0.06), np.sin(-0.06)
    values = np.stack([c * z[:, 0] - s * z[:, 1], s * z[:, 0] + c * z[:, 1], z[:, 2]], axis=1)
    P0 = np.diag([1.0, 1.0, 0, 0, 0, 0, 0.01, 0.01, 0, 0, 0])
    dt, growth = np.full(n, 1.0 / n), np.zeros(2)
    states = None
    for k in range(5):
        states, *_ = _follow(
            planes, 1e-4, away, dt, values, start, P0, growth, about=k > 0, states=states, turning=True
        )
    assert states is not None
    np.testing.assert_allclose(states[:, [0, 1, 6, 7]], truth[:, [0, 1, 6, 7]], atol=5e-3)


def test_with_a_wide_prediction_each_point_comes_to_lie_on_its_contour() -> None:
    """The limit in which the published method works: the gain is one."""
    rng = np.random.default_rng(6)
    slope = np.array([[1.0, 0.5]])
    away, dt = np.zeros((8, 2)), np.full(8, 1.0)
    values = 50.0 + rng.normal(0.0, 3.0, (8, 1))
    P0 = np.diag([1e4, 1e4, 0, 0, 0, 0, 0, 0, 0.0])
    states, *_ = _follow(
        _planes(slope, np.zeros(1)), 1e-4, away, dt, values, np.array([30.0, 30.0]), P0, np.array([1e4, 0])
    )
    x, y = np.array([place(np.array([30.0, 30.0]), one, away[0]) for one in states]).T
    np.testing.assert_allclose(x + 0.5 * y, values[:, 0], atol=1e-3)


@pytest.mark.parametrize("fill", [7.0, np.nan])
def test_without_contours_the_prediction_stays(fill: float) -> None:
    planes = np.full((1, 60, 70), fill, dtype=np.float32)
    P0 = np.diag([1.0, 2.0, 0, 0, 0, 0, 0, 0, 0.0])
    found = _follow(
        planes, 0.1, np.zeros((3, 2)), np.ones(3), np.full((3, 1), 7.0), np.array([5.0, 5.0]), P0, np.zeros(2)
    )
    assert found[3] == 0
    np.testing.assert_array_equal(found[0], 0.0)
    np.testing.assert_allclose(found[1], P0)
    assert np.isfinite(found[2])
