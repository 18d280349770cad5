"""The radio kernel against its slow twin."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator

from app.engine.kernels.radio import interpolate, scan_log_likelihood


def naive_scan_log_likelihood(rows, rssi, weight, mean, sd, seen, unseen, offset_var, most, anchors):
    """One node and one reading at a time; the offset is the weighted mean of residuals, twice."""
    out = []
    for s in range(mean.shape[1]):
        sigma = [0.1 * sd[row, s] for row in rows]
        residual = [r - float(mean[row, s]) for r, row in zip(rssi, rows, strict=True)]
        offset, slope = 0.0, 0.0
        every = max(1, int(np.ceil(len(rows) / anchors)))
        for _ in range(2):
            inverse = [
                w / (1.0 + slope * ((e - offset) / q) ** 2) ** 2 / q**2
                for w, e, q in zip(weight[::every], residual[::every], sigma[::every], strict=True)
            ]
            pulled = sum(i * e for i, e in zip(inverse, residual[::every], strict=True))
            offset = pulled / (sum(inverse) + 1.0 / offset_var)
            slope = 0.5 / most
        total = -0.5 * offset**2 / offset_var
        for w, e, q, row in zip(weight, residual, sigma, rows, strict=True):
            u2 = ((e - offset) / q) ** 2
            total += w * (np.log(max(seen[row, s] / 255.0, unseen)) - np.log(q) - 0.5 * u2 / (1.0 + 0.5 * u2 / most))
        out.append(total)
    return np.array(out)


@pytest.mark.parametrize("anchors", [64, 16, 1])
@pytest.mark.parametrize("k", [0, 1, 40])
def test_agrees_with_the_readings_one_by_one(k: int, anchors: int) -> None:
    rng = np.random.default_rng(7)
    shape = (50, 70)
    mean = rng.integers(-128, 128, shape).astype(np.int8)
    sd = rng.integers(1, 256, shape).astype(np.uint8)
    seen = rng.integers(0, 256, shape).astype(np.uint8)
    rows = rng.integers(0, 50, k)
    rssi, weight = rng.uniform(-100.0, -30.0, k), rng.uniform(0.2, 1.0, k)
    byte = np.arange(256)
    log_seen = np.log(np.maximum(byte / 255.0, 0.003)).astype(np.float32)
    log_sd = np.log(np.maximum(0.1 * byte, 0.1)).astype(np.float32)
    out = np.full(70, np.nan, np.float32)
    scan_log_likelihood(
        rows, rssi, weight, mean, sd, seen, log_seen, log_sd, 25.0, 6.0, anchors, np.empty((3, 70), np.float32), out
    )
    expected = naive_scan_log_likelihood(rows, rssi, weight, mean, sd, seen, 0.003, 25.0, 6.0, anchors)
    np.testing.assert_allclose(out, expected, rtol=2e-4, atol=2e-2)


@pytest.mark.parametrize("shape", [(2, 2), (7, 5)])
def test_interpolation_agrees_with_scipy(shape: tuple[int, int]) -> None:
    """Beyond the grid the edge holds."""
    rng = np.random.default_rng(8)
    grid = rng.standard_normal(shape).astype(np.float32)
    rows, columns = -1.0 + 3.0 * np.arange(shape[0]), 2.0 + 3.0 * np.arange(shape[1])
    x, y = rng.uniform(-10.0, 30.0, (2, 500))
    out = np.empty(500)
    interpolate(grid, 2.0, -1.0, 3.0, x, y, out)
    inside = np.stack([np.clip(y, rows[0], rows[-1]), np.clip(x, columns[0], columns[-1])], axis=1)
    np.testing.assert_allclose(out, RegularGridInterpolator((rows, columns), grid)(inside), atol=1e-6)


def test_interpolation_of_one_node_is_constant() -> None:
    out = np.empty(3)
    interpolate(np.full((1, 1), 4.0, np.float32), 0.0, 0.0, 3.0, np.array([-9.0, 0.0, 9.0]), np.zeros(3), out)
    np.testing.assert_array_equal(out, 4.0)
