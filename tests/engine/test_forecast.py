"""The forecast is a bound that a maximum-likelihood fix comes near to, and follows what it should."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.interpolate import RectBivariateSpline
from scipy.linalg import cho_factor, cho_solve

from app.engine.errors import InputError, MapError
from app.engine.mapping.forecast import WalkerErrors, forecast_accuracy, forecast_route
from app.engine.types import FeatureSet, Float64Array, GridMap
from tests.support.fields import field_map

STEP_M = 0.5


def informative(seed: int = 1, **changes: object) -> GridMap:
    grid = field_map(np.random.default_rng(seed), shape=(60, 80), length_m=2.0, spread_ut=6.0, sd_ut=0.8)
    return replace(grid, noise_sd=(2.0, 2.0, 2.5), **changes)


@dataclass
class Simulation:
    """Walks along +x through a vector map, as the forecast supposes them, and their fix by Gauss-Newton."""

    grid: GridMap
    errors: WalkerErrors
    start: tuple[float, float]
    n: int

    def __post_init__(self) -> None:
        rows, columns = self.grid.shape
        x = self.grid.x0 + self.grid.cell_m * np.arange(columns)
        y = self.grid.y0 + self.grid.cell_m * np.arange(rows)
        self.field = [RectBivariateSpline(y, x, mean.astype(np.float64)) for mean in self.grid.mean]
        e, legs = self.errors, self.n - 1
        start = [e.position_m**2] * 2 + [e.heading**2] + [e.offset**2] * 3
        self.variance = np.concatenate([start, np.tile(np.array([e.along**2, e.across**2]) * STEP_M, legs)])
        way = STEP_M * np.arange(self.n)
        shared = np.exp(-np.abs(way[:, None] - way) / e.shared_m)
        self.noise = []
        for sd, unsure in zip(self.grid.noise_sd, self.grid.sd[:, 0, 0].astype(float), strict=True):
            white = (1 - e.shared) * sd**2 * e.reading_m / STEP_M
            self.noise.append((e.shared * sd**2 + unsure**2) * shared + white * np.eye(self.n))
        self.factors = [cho_factor(noise) for noise in self.noise]
        # states are linear in the unknowns
        origin = self.states(np.zeros(len(self.variance)))
        self.linear = np.stack([self.states(one) - origin for one in np.eye(len(self.variance))], axis=-1)

    def states(self, unknown: Float64Array) -> Float64Array:
        """x, y, heading error and offsets at each reading, shape (n, 6)."""
        legs = unknown[6:].reshape(-1, 2)
        step = np.stack([STEP_M + legs[:, 0], STEP_M * unknown[2] + legs[:, 1]], axis=1)
        xy = np.vstack([unknown[:2], unknown[:2] + np.cumsum(step, axis=0)])
        return np.hstack([xy + np.array(self.start), np.tile(unknown[2:6], (self.n, 1))])

    def readings(self, states: Float64Array) -> Float64Array:
        """Field in the frame of the believed heading, with offsets, shape (n, 3)."""
        m = np.stack([f.ev(states[:, 1], states[:, 0]) for f in self.field], axis=1)
        turned = np.stack([m[:, 0] + states[:, 2] * m[:, 1], m[:, 1] - states[:, 2] * m[:, 0], m[:, 2]], axis=1)
        return turned + states[:, 3:]

    def slopes(self, states: Float64Array) -> Float64Array:
        """Derivatives of the readings by the states, shape (n, 3, 6)."""
        y, x = states[:, 1], states[:, 0]
        m = np.stack([f.ev(y, x) for f in self.field], axis=1)
        d = np.zeros((self.n, 3, 6))
        d[:, :, 0] = np.stack([f.ev(y, x, dy=1) for f in self.field], axis=1)
        d[:, :, 1] = np.stack([f.ev(y, x, dx=1) for f in self.field], axis=1)
        d[:, 0, 2], d[:, 1, 2] = m[:, 1], -m[:, 0]
        d[:, :, 3:] = np.eye(3)
        return d

    def error(self, rng: np.random.Generator) -> tuple[float, float]:
        """Error of one walk's last position along and across, m, at its nearest maximum of the posterior density."""
        size = len(self.variance)
        truth = np.sqrt(self.variance) * rng.standard_normal(size)
        states = self.states(truth)
        noise = np.stack([np.linalg.cholesky(c) @ rng.standard_normal(self.n) for c in self.noise], axis=1)
        z = self.readings(states) + noise
        unknown = truth.copy()
        for _ in range(6):
            at = self.states(unknown)
            d = np.moveaxis(self.slopes(at) @ self.linear, 1, 0)
            gap = (z - self.readings(at)).T
            normal, right = np.diag(1.0 / self.variance), -unknown / self.variance
            for k, factor in enumerate(self.factors):
                weighted = cho_solve(factor, d[k]).T
                normal = normal + weighted @ d[k]
                right = right + weighted @ gap[k]
            unknown = unknown + np.linalg.solve(normal, right)
        off = self.states(unknown)[-1, :2] - states[-1, :2]
        return float(off[0]), float(off[1])


def test_a_fix_of_greatest_likelihood_comes_near_the_bound() -> None:
    rng = np.random.default_rng(5)
    grid, errors = informative(), WalkerErrors(position_m=1.0, heading_walk=0.0, offset_walk=0.0)
    squares, bounds = [], []
    for start in [(-5.0, -15.0), (-6.0, 0.0), (2.0, -4.0), (5.0, -10.0)]:
        simulation = Simulation(grid, errors, start, 21)
        squares.append(np.mean([np.square(simulation.error(rng)) for _ in range(40)], axis=0))
        end = (start[0] + 10.0, start[1])
        forecast = forecast_route(grid, np.array([start, end]), errors)
        bounds.append([forecast.along[-1] ** 2, forecast.across[-1] ** 2])
    ratio = np.sqrt(np.mean(squares, axis=0) / np.mean(bounds, axis=0))
    assert ((ratio > 0.85) & (ratio < 1.3)).all(), ratio
    assert np.sqrt(np.sum(squares) / np.sum(bounds)) == pytest.approx(1.08, abs=0.18)


def test_correlated_errors_are_no_independent_witnesses() -> None:
    grid = informative()
    alone = forecast_accuracy(grid, WalkerErrors(shared=0.0)).mean_error()
    together = forecast_accuracy(grid, WalkerErrors(shared=1.0)).mean_error()
    assert np.median(together) > 1.2 * np.median(alone)


def test_a_flat_field_tells_nothing() -> None:
    grid = informative()
    flat = replace(grid, mean=np.broadcast_to(grid.mean.mean(axis=(1, 2), keepdims=True), grid.mean.shape).copy())
    forecast = forecast_route(flat, np.array([[-8.0, 0.0], [12.0, 0.0]]), WalkerErrors(heading=0.0, heading_walk=0.0))
    errors = WalkerErrors()
    expected = np.sqrt(2 * errors.position_m**2 + forecast.way * (errors.along**2 + errors.across**2))
    np.testing.assert_allclose(forecast.error, expected, rtol=1e-6)


def test_stripes_tell_only_the_way_across_them() -> None:
    grid = informative()
    x = grid.x0 + grid.cell_m * np.arange(grid.shape[1])
    stripes = np.array([0.0, 0.0, -40.0])[:, None, None] + 8.0 * np.sin(x / 1.5)[None, None, :]
    grid = replace(grid, mean=np.broadcast_to(stripes, grid.mean.shape).astype(np.float32))
    forecast = forecast_accuracy(grid)
    middle = (30, 40)
    assert 2.5 * forecast.along(0)[middle] < forecast.across(0)[middle]
    assert 2.5 * forecast.across(2)[middle] < forecast.along(2)[middle]


def test_equivariance_under_a_quarter_turn() -> None:
    grid = replace(informative(), features=FeatureSet.TOTAL, noise_sd=(2.0,))
    grid = replace(grid, mean=grid.mean[2:], sd=grid.sd[2:])
    turned = replace(
        grid,
        mean=np.ascontiguousarray(np.rot90(grid.mean, axes=(1, 2))),
        sd=np.ascontiguousarray(np.rot90(grid.sd, axes=(1, 2))),
        support=np.ascontiguousarray(np.rot90(grid.support)),
    )
    # rows count upwards: numpy's rot90 is a quarter turn clockwise on the plan
    a, b = forecast_accuracy(grid), forecast_accuracy(turned)
    np.testing.assert_allclose(np.rot90(a.error(0)), b.error(6), rtol=1e-3)
    np.testing.assert_allclose(np.rot90(a.error(3)), b.error(1), rtol=1e-3)


def test_a_map_less_sure_gives_a_larger_error() -> None:
    grid = informative()
    unsure = replace(grid, sd=grid.sd * 4)
    assert (forecast_accuracy(unsure).mean_error() > forecast_accuracy(grid).mean_error()).all()


def test_nobody_comes_out_of_a_wall() -> None:
    grid = informative()
    obstacle = np.zeros(grid.shape, np.float32)
    obstacle[:20] = obstacle[26:] = 3.0
    forecast = forecast_accuracy(replace(grid, obstacle=obstacle))
    assert np.isnan(forecast.mean_error()[10]).all()
    assert forecast.approach[0, 22, 60] == pytest.approx(30.0)
    assert forecast.approach[2, 20].max() == 0.0
    # a metre out of the wall is less than half of the way along the corridor
    assert (forecast.approach[2, 22, 60], forecast.weights()[2, 22, 60]) == (1.0, 0.0)
    assert forecast.weights()[0, 22, 60] == 1.0
    # the worst heading is one that leads here, not the one out of the wall, which has seen one reading only
    assert forecast.error(2)[20, 60] > forecast.worst_error()[20, 60] >= forecast.error(0)[20, 60]


def test_refusals() -> None:
    grid = informative()
    with pytest.raises(InputError, match="two different points"):
        forecast_route(grid, np.array([[1.0, 1.0], [1.0, 1.0]]))
    with pytest.raises(InputError, match="finite"):
        forecast_route(grid, np.array([[1.0, np.nan], [1.0, 1.0]]))
    thin = replace(grid, mean=grid.mean[:, :1], sd=grid.sd[:, :1], support=grid.support[:1])
    with pytest.raises(MapError):
        forecast_accuracy(thin)
