"""Lines of particles: kernels against their slow twins."""

from __future__ import annotations

import numpy as np
import pytest

from app.engine.kernels import lines
from tests.reference import naive


def places(xy: np.ndarray) -> np.ndarray:
    """Places of particles at (2, n) metres, from the reference (100, -50)."""
    x, y = (np.ascontiguousarray(row, dtype=np.float32) for row in xy)
    out = np.empty((len(x), 2), dtype=np.int16)
    lines.record(x, y, 100.0, -50.0, out)
    return out


def moments(xy: np.ndarray, w: np.ndarray) -> np.ndarray:
    est = np.empty(5)
    lines.moments(xy, w.astype(np.float32), est)
    return est


@pytest.mark.parametrize("spread_m", [0.0, 0.5, 30.0, 900.0])
def test_places_are_centimetres_from_the_reference(spread_m: float) -> None:
    xy = np.array([[100.0], [-50.0]]) + spread_m * np.random.default_rng(5).standard_normal((2, 500))
    expected = naive.record_lines(*xy.astype(np.float32).astype(np.float64), 100.0, -50.0)
    found = places(xy).astype(int)
    # single precision: a place near half a centimetre may go either way
    assert np.abs(found - expected).max() <= (1 if spread_m else 0)
    assert np.mean(found == expected) > 0.99
    if spread_m > 500:
        assert np.abs(found).max() == lines.REACH_CM


@pytest.mark.parametrize("total", [1.0, 7.0])
@pytest.mark.parametrize("spread_m", [0.0, 0.02, 1.0, 100.0])
def test_moments_are_those_of_the_definition(spread_m: float, total: float) -> None:
    rng = np.random.default_rng(6)
    xy = places(np.array([[101.0], [-52.0]]) + spread_m * rng.standard_normal((2, 1000)))
    w = (total * rng.dirichlet(np.full(1000, 0.2))).astype(np.float32)
    np.testing.assert_allclose(moments(xy, w), naive.line_moments(xy, w.astype(np.float64)), rtol=1e-6, atol=1e-9)


def test_one_heavy_line_is_all() -> None:
    xy = np.array([[-300, 7], [20, 8], [512, -9]], dtype=np.int16)
    np.testing.assert_allclose(moments(xy, np.array([0.0, 0.0, 3.0])), [5.12, -0.09, 0.0, 0.0, 0.0], atol=1e-12)
