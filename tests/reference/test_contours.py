"""Nearest points of contours (`app.engine.kernels.contours`) against a contour cut into thousands of points."""

from __future__ import annotations

import numpy as np
import pytest

from app.engine.kernels.contours import FOUND, nearest_points
from tests.reference import contours as slow

_APART = 6e-4
"""Half the spacing of the slow twin's points, at their widest, cells."""


def _nearest(plane, x, y, values, radius):  # type: ignore[no-untyped-def]
    out = np.empty((len(x), FOUND))
    nearest_points(plane.astype(np.float32), x, y, values, radius, out)
    return out


def _compare(plane: np.ndarray, x: np.ndarray, y: np.ndarray, value: float, radius: float) -> None:
    plane = plane.astype(np.float32)
    found = _nearest(plane, x, y, np.full(len(x), value), radius)
    for k in range(len(x)):
        expected = slow.nearest_point(plane, x[k], y[k], value, radius)
        if np.isinf(expected[2]):
            assert np.isinf(found[k, 4]) or found[k, 4] > radius - _APART
            continue
        assert found[k, 4] == pytest.approx(expected[2], abs=_APART)
        assert np.hypot(found[k, 0] - x[k], found[k, 1] - y[k]) == pytest.approx(found[k, 4], abs=1e-9)


@pytest.mark.parametrize("seed", range(6))
def test_rough_maps_full_of_saddles(seed: int) -> None:
    rng = np.random.default_rng(seed)
    plane = rng.standard_normal((5, 6))
    _compare(plane, rng.uniform(-2, 7, 25), rng.uniform(-2, 6, 25), float(rng.normal(0, 0.5)), 4.0)


def test_smooth_map_and_small_radius() -> None:
    v, u = np.mgrid[0:6, 0:7]
    rng = np.random.default_rng(9)
    _compare(np.sin(0.7 * u) + np.cos(0.5 * v), rng.uniform(0, 6, 25), rng.uniform(0, 5, 25), 0.3, 0.6)


@pytest.mark.parametrize("value", [1e-3, 0.999, 0.5])
def test_plateaus_edges_and_values_at_the_nodes(value: float) -> None:
    plane = np.array([[0, 0, 1, 1], [0, 1, 1, 0], [1, 0, 0, 1.0]])
    x, y = np.array([0.0, 1.0, 1.5, 3.0, 2.2]), np.array([0.0, 1.0, 0.5, 2.0, 1.9])
    _compare(plane, x, y, value, 3.0)


def test_unmapped_nodes_hold_no_contour() -> None:
    rng = np.random.default_rng(3)
    plane = rng.standard_normal((5, 6))
    plane[2, 3] = np.nan
    _compare(plane, rng.uniform(0, 5, 20), rng.uniform(0, 4, 20), 0.1, 5.0)


def test_nothing_to_find() -> None:
    x = np.array([2.0, np.nan, 1e12, -50.0])
    for plane in (np.full((4, 5), 7.0), np.full((1, 1), 7.0), np.full((1, 5), 7.0)):
        found = _nearest(plane, x, np.ones(4), np.full(4, 7.0), 3.0)
        assert np.isinf(found[:, 4]).all()


def test_the_map_has_the_value_at_what_is_found_and_the_gradient_is_its_own() -> None:
    rng = np.random.default_rng(5)
    plane = rng.standard_normal((30, 30)).astype(np.float32)
    x, y, values = rng.uniform(0, 29, 200), rng.uniform(0, 29, 200), rng.normal(0.0, 0.5, 200)
    out = _nearest(plane, x, y, values, 10.0)
    assert np.isfinite(out[:, 4]).all()
    j, i = np.minimum(out[:, 0].astype(int), 28), np.minimum(out[:, 1].astype(int), 28)
    u, v = out[:, 0] - j, out[:, 1] - i
    m = plane.astype(float)
    b, c = m[i, j + 1] - m[i, j], m[i + 1, j] - m[i, j]
    d = m[i + 1, j + 1] - m[i + 1, j] - b
    np.testing.assert_allclose(m[i, j] + b * u + c * v + d * u * v, values, atol=1e-5)
