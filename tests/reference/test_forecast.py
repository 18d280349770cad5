from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from app.engine.kernels import forecast as kernel
from app.engine.mapping.forecast import (
    HEADINGS_DEG,
    WalkerErrors,
    forecast_accuracy,
    forecast_route,
    nearest_nodes,
    resample,
)
from app.engine.types import FeatureSet, Float32Array, Float64Array, GridMap
from tests.reference.forecast import likest_place, posterior_covariances
from tests.support.fields import field_map

ERRORS = WalkerErrors(heading=0.2, offset=2.0)


def level(features: FeatureSet, seed: int = 0) -> GridMap:
    """A small map with a wall and an unmapped strip."""
    grid = field_map(np.random.default_rng(seed), features=features, shape=(8, 14), sd_ut=0.7)
    support = grid.support.copy()
    support[:, 3:5] = 4.0
    obstacle = np.zeros(grid.shape, np.float32)
    obstacle[3, 2] = 2.0
    noise = tuple(1.5 + 0.5 * k for k in range(len(features.channels)))
    return replace(grid, support=support, obstacle=obstacle, noise_sd=noise)


def nodes_of(grid: GridMap, row: np.ndarray, column: np.ndarray) -> Float32Array:
    slope_y, slope_x = np.gradient(grid.mean.astype(np.float64), grid.cell_m, axis=(1, 2))
    parts = [grid.mean, slope_x, slope_y, grid.sd.astype(np.float64) ** 2]
    return np.stack([part[:, row, column].T for part in parts], axis=-1).astype(np.float32)


def slow(grid: GridMap, row: np.ndarray, column: np.ndarray, steps: Float64Array) -> Float64Array:
    vector = grid.features is FeatureSet.VECTOR
    mapped = grid.mapped[row, column]
    return posterior_covariances(nodes_of(grid, row, column), mapped, steps, grid.noise_sd, ERRORS, vector=vector)


@pytest.mark.parametrize("features", list(FeatureSet))
@pytest.mark.parametrize("heading", range(8))
def test_a_line_of_nodes(features: FeatureSet, heading: int) -> None:
    grid = level(features)
    angle = np.radians(HEADINGS_DEG[heading])
    dr, dc = int(np.rint(np.sin(angle))), int(np.rint(np.cos(angle)))
    # the line through (4, 9), from the edge of the grid on
    at = [(4 + i * dr, 9 + i * dc) for i in range(-30, 31)]
    row, column = np.array([(r, c) for r, c in at if 0 <= r < 8 and 0 <= c < 14]).T
    steps = np.tile(np.array([dc, dr]) * grid.cell_m, (len(row), 1))
    expected = slow(grid, row, column, steps)
    whole = forecast_accuracy(grid, ERRORS)
    assert (whole.x0, whole.y0, whole.cell_m) == (grid.x0, grid.y0, grid.cell_m)
    found = whole.covariance[heading, row, column]
    mapped = grid.mapped[row, column]
    assert mapped.sum() > 5
    np.testing.assert_allclose(found[mapped, 0], expected[mapped, 0, 0], rtol=2e-4)
    np.testing.assert_allclose(found[mapped, 1], expected[mapped, 0, 1], rtol=2e-3, atol=2e-4)
    np.testing.assert_allclose(found[mapped, 2], expected[mapped, 1, 1], rtol=2e-4)
    assert np.isnan(found[~mapped]).all()


@pytest.mark.parametrize("features", list(FeatureSet))
def test_a_route_with_turns_and_a_gap(features: FeatureSet) -> None:
    grid = level(features, seed=3)
    route = np.array([[-9.8, -19.5], [-4.0, -19.0], [-4.5, -17.0], [-9.0, -17.0]])
    found = forecast_route(grid, route, ERRORS)
    steps = np.diff(found.xy, axis=0)
    steps = np.concatenate([steps[:1], steps])
    row, column, _ = nearest_nodes(grid, found.xy)
    expected = slow(grid, row, column, steps)
    assert not found.mapped.all()
    np.testing.assert_allclose(found.error, np.sqrt(np.trace(expected, axis1=1, axis2=2)), rtol=1e-4)
    u = steps / np.hypot(*steps.T)[:, None]
    np.testing.assert_allclose(found.along**2, np.einsum("ni,nij,nj->n", u, expected, u), rtol=1e-4)


@pytest.mark.parametrize("seed", range(4))
def test_the_place_most_like_a_stretch(seed: int) -> None:
    rng = np.random.default_rng(seed)
    mean = rng.normal(size=(12, 15, 2)).astype(np.float32)
    mapped = rng.random((12, 15)) > 0.1
    rows, columns = np.array([4, 4, 5, 5, 6]), np.array([5, 6, 6, 7, 7])
    mapped[rows, columns] = True
    if seed == 0:  # a copy of the stretch with an offset: found exactly
        mean[rows + 3, columns - 4] = mean[rows, columns] + np.float32(7.0)
        mapped[rows + 3, columns - 4] = True
    weight, best = np.array([0.5, 0.2]), np.empty(3)
    kernel.rivals(mean, mapped, rows, columns, weight, 4, 3.0, 1e9, best)
    expected = likest_place(mean, mapped, rows, columns, weight, least=4, near=3.0)
    assert best[0] == pytest.approx(expected[0], rel=1e-9, abs=1e-9)
    if seed == 0:
        assert best[0] == pytest.approx(0.0, abs=1e-9)
    assert (int(best[1]), int(best[2])) == expected[1:]


def test_a_stretch_without_another_place_is_left_alone() -> None:
    best = np.empty(3)
    mean, rows = np.zeros((2, 4, 1), np.float32), np.array([0, 0, 0, 0])
    kernel.rivals(mean, np.ones((2, 4), bool), rows, np.arange(4), np.ones(1), 4, 2.0, 16.0, best)
    assert best.tolist() == [16.0, 0.0, 0.0]


def test_resampling_keeps_corners_and_length() -> None:
    route = np.array([[0.0, 0.0], [0.0, 0.0], [3.2, 0.0], [3.2, 0.1]])
    way, xy = resample(route, 0.5)
    assert way[-1] == pytest.approx(3.3)
    assert np.diff(way).max() <= 0.5 + 1e-12
    np.testing.assert_allclose(np.hypot(*np.diff(xy, axis=0).T), np.diff(way), atol=1e-12)
    assert (np.abs(xy - [3.2, 0.0]).max(axis=1) < 1e-12).any()
