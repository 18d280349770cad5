"""Gatherings of particles (`app.engine.kernels.modes`) against their slow twin."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import uniform_filter

from app.engine.filtering import Cloud, find_modes


def naive_find_modes(x, y, w, radius, most, least):
    """Peaks of the smoothed weight in 2 m cells, one by one, with whole arrays in double precision."""
    w = w / w.sum()
    cell = max(2.0, max(np.ptp(x), np.ptp(y)) / 500)
    column, row = ((v - v.min()) // cell for v in (x, y))
    free, modes = np.ones(len(x), dtype=bool), []
    for _ in range(most):
        weight = np.zeros((int(row.max()) + 1, int(column.max()) + 1))
        np.add.at(weight, (row[free].astype(int), column[free].astype(int)), w[free])
        peak = np.unravel_index(uniform_filter(weight, 3, mode="constant").argmax(), weight.shape)
        px, py = x.min() + (peak[1] + 0.5) * cell, y.min() + (peak[0] + 0.5) * cell
        near = free & (np.hypot(x - px, y - py) <= max(radius, 3.0 * cell))
        share = w[near].sum()
        if share <= 0.0 or (modes and share < least):
            break
        cov = np.cov(np.stack([x[near], y[near]]), aweights=w[near], ddof=0).reshape(2, 2)
        mx, my = np.average(x[near], weights=w[near]), np.average(y[near], weights=w[near])
        modes.append((mx, my, cov[0, 0], cov[0, 1], cov[1, 1], share))
        free &= ~near
    return sorted(modes, key=lambda mode: -mode[-1])


@pytest.mark.parametrize("n", [1, 2, 30, 5000])
@pytest.mark.parametrize("spread", [0.0, 1.0, 60.0, 1e5])
def test_agrees_with_whole_arrays(n: int, spread: float) -> None:
    rng = np.random.default_rng(n)
    cloud = Cloud.empty(n)
    cloud.p[0], cloud.p[1] = 200.0 + spread * rng.standard_normal((2, n))
    cloud.p[14] = rng.exponential(1.0, n) ** 4  # a few particles hold most of the weight
    x, y, w = (cloud.p[k].astype(np.float64) for k in (0, 1, 14))
    expected = naive_find_modes(x, y, w, 6.0, 5, 0.02)
    found = [(m.x, m.y, m.cov_xx, m.cov_xy, m.cov_yy, m.weight) for m in find_modes(cloud)]
    assert len(found) == len(expected)
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-5)
