"""Kernels against their slow twins, on random, degenerate and adversarial input."""

from __future__ import annotations

import numpy as np
import pytest
from filterpy.monte_carlo import systematic_resample
from scipy.spatial.transform import Rotation

from app.engine.inertial import steps as step_module
from app.engine.inertial import window_means
from app.engine.kernels import particle
from app.engine.kernels.attitude import level
from app.engine.kernels.windows import pauta_means
from tests.reference import naive

LEVEL = np.array([0.25, 1.0, 4e-4, 0.02, 0.06, 1.5, 2.0])
"""Parameters of the attitude kernel."""


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(7)


class TestAttitude:
    @pytest.mark.parametrize("hold", ["flat", "upright", "upside down", "face down"])
    def test_agrees_with_rotation_vectors(self, rng: np.random.Generator, hold: str) -> None:
        n = 400
        t = np.cumsum(rng.uniform(0.005, 0.03, n))
        start = {
            "flat": Rotation.identity(),
            "upright": Rotation.from_euler("x", 80, degrees=True),
            "upside down": Rotation.from_euler("x", -75, degrees=True),
            "face down": Rotation.from_euler("y", 170, degrees=True),
        }[hold]
        gyro = 0.8 * np.sin(np.outer(t, [1.0, 1.3, 0.7])) + 0.1 * rng.standard_normal((n, 3))
        acc = start.inv().apply([0.0, 0.0, 9.81]) + 2.0 * rng.standard_normal((n, 3))
        mag = 30.0 * rng.standard_normal((n, 3))
        x, y, z, w = start.as_quat()
        moving, rest = np.zeros(n, dtype=bool), np.zeros(12)
        out = np.empty((n, 8))
        level(t, mag, acc, gyro, moving, np.array([w, x, y, z]), np.zeros(2), rest.copy(), LEVEL, out)
        expected = naive.level(t, mag, acc, gyro, moving, start, 0.0, 0.0, rest, LEVEL)
        # the kernel integrates to first order within a sample: 0.02 rad of turn leave 1e-6 rad each
        np.testing.assert_allclose(out[:, 3], expected[:, 3], atol=2e-3)
        np.testing.assert_allclose(out[:, :3], expected[:, :3], atol=0.3)
        np.testing.assert_allclose(out[:, 4], expected[:, 4], atol=0.03)
        np.testing.assert_allclose(out[:, 5:], expected[:, 5:], atol=2e-3)

    @pytest.mark.parametrize("moves", [False, True])
    def test_rest_is_learned_alike(self, rng: np.random.Generator, moves: bool) -> None:
        """Ten seconds still with a gyroscope that is off, five of waving, ten still again."""
        n, t = 1250, 0.02 * np.arange(1, 1251)
        waving = (t > 10) & (t < 15)
        gyro = np.array([0.004, -0.003, 0.01]) + 0.002 * rng.standard_normal((n, 3))
        gyro[waving] += np.sin(3.0 * t[waving])[:, None]
        acc = np.array([0.0, 0.0, 9.81]) + 0.05 * rng.standard_normal((n, 3))
        mag, moving, rest = np.full((n, 3), 30.0), np.full(n, moves), np.zeros(12)
        out, last = np.empty((n, 8)), np.zeros(2)
        rest[9] = 9.8
        after = rest.copy()
        level(t, mag, acc, gyro, moving, np.array([1.0, 0, 0, 0]), last, after, LEVEL, out)
        expected = naive.level(t, mag, acc, gyro, moving, Rotation.identity(), 0.0, 0.0, rest, LEVEL)
        np.testing.assert_allclose(out, expected, atol=2e-3)
        np.testing.assert_allclose(after[:3], np.zeros(3) if moves else [0.004, -0.003, 0.01], atol=1e-3)

    def test_free_fall_does_not_break_it(self) -> None:
        n = 50
        t = 0.02 * np.arange(1, n + 1)
        out = np.empty((n, 8))
        zeros, still = np.zeros((n, 3)), np.zeros(n, dtype=bool)
        level(t, zeros, zeros, zeros, still, np.array([1.0, 0, 0, 0]), np.zeros(2), np.zeros(12), LEVEL, out)
        assert np.isfinite(out).all()


def _particles(rng: np.random.Generator, n: int) -> np.ndarray:
    p = np.zeros((particle.ROWS, n), dtype=np.float32)
    p[0], p[1] = rng.uniform(2, 15, (2, n))
    heading = rng.uniform(-np.pi, np.pi, n)
    p[2], p[3] = np.cos(heading), np.sin(heading)
    p[4] = 1 + 0.1 * rng.standard_normal(n)
    p[5] = 0.1 * rng.standard_normal(n)
    p[6:12] = 2 * rng.standard_normal((6, n))
    p[12], p[13] = rng.uniform(0.5, 20, (2, n))
    p[14] = 1.0 / n
    return p


def _grid(rng: np.random.Generator) -> np.ndarray:
    grid = np.zeros((36, 41, 7), dtype=np.float32)
    grid[..., :3] = 3 * rng.standard_normal((36, 41, 3)) + [0, 30, -30]
    grid[..., 3:5] = rng.uniform(0.5, 9, (36, 41, 2))
    grid[..., 5] = rng.random((36, 41)) < 0.5
    grid[..., 6] = rng.uniform(0.01, 1, (36, 41))
    return grid


MOTION = np.array([0.0, 0.0, 0.7, 0.0, 0.0])
PAR = np.array([2.0, 0.02, 0.1, 0.01, 0.01, 0.1, 9.0, 12.0, 0.4, 5.0, 0.5, 0.01, 0.15])


class TestParticleStep:
    @pytest.mark.parametrize("first", [True, False])
    @pytest.mark.parametrize("mode", [particle.VECTOR, particle.HV, particle.TOTAL])
    @pytest.mark.parametrize("n", [1, 2, 300])
    def test_agrees_with_one_particle_at_a_time(self, rng: np.random.Generator, n: int, mode: int, first: bool) -> None:
        p, grid = _particles(rng, n), _grid(rng)
        motion = np.array([0.1, 0.25, 0.7, 0.5, 1.0])
        z = np.array([5.0, -20.0, -28.0])
        pool = rng.standard_normal(4 * n + 3).astype(np.float32)
        expected, moments, index = naive.particle_step(
            p, grid, motion, z, PAR, mode, first, pool[3:].reshape(4, n).astype(float), 0.3
        )
        q, est, ancestor = np.empty_like(p), np.empty(10), np.empty(n, np.int64)
        resampled = particle.step(p, q, grid, motion, z, PAR, mode, first, pool, 3, 0.3, est, ancestor)
        np.testing.assert_allclose(p[:14], expected[:14], rtol=2e-3, atol=5e-3)
        np.testing.assert_allclose(p[14], expected[14], rtol=2e-2, atol=1e-6)
        np.testing.assert_allclose(est[:6], moments[:6], rtol=2e-2, atol=3e-2)
        np.testing.assert_allclose(est[8:], moments[8:], rtol=2e-2)
        turn = np.arctan2(est[7], est[6]) - np.arctan2(moments[7], moments[6])
        assert abs(np.angle(np.exp(1j * turn))) < 0.02
        assert resampled == (index is not None)
        if resampled:
            # boundaries of the float32 weights themselves: a rounding may pass over a particle of no weight
            own = np.searchsorted(np.cumsum(p[14], dtype=float), (np.arange(n) + 0.3) / n)
            assert (ancestor != own).mean() < 0.02
            assert (ancestor != index).mean() < 0.05
            np.testing.assert_array_equal(q[:14], p[:14, ancestor])
            np.testing.assert_allclose(q[14], 1.0 / n)

    def test_resampling_is_that_of_filterpy(self, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch) -> None:
        n = 500
        p, grid = _particles(rng, n), _grid(rng)
        pool = rng.standard_normal(4 * n).astype(np.float32)
        par = PAR.copy()
        par[10] = 10.0  # always resample
        q, est, ancestor = np.empty_like(p), np.empty(10), np.empty(n, np.int64)
        particle.step(
            p, q, grid, np.array([0, 0, 0.7, 0, 0.0]), np.zeros(3), par, 0, True, pool, 0, 0.42, est, ancestor
        )
        monkeypatch.setattr("filterpy.monte_carlo.resampling.random", lambda: 0.42)
        weights = p[14].astype(float)
        assert (np.abs(systematic_resample(weights / weights.sum()) - ancestor) <= 1).all()

    def test_resampling_is_unbiased(self, rng: np.random.Generator) -> None:
        """Each particle's expected number of children is n times its weight."""
        n, trials = 50, 2000
        p0, grid = _particles(rng, n), _grid(rng)
        pool = rng.standard_normal(4 * n).astype(np.float32)
        par = PAR.copy()
        par[10] = 10.0
        children = np.zeros(n)
        weights = np.zeros(n)
        for u in (np.arange(trials) + 0.5) / trials:
            p = p0.copy()
            q, est, ancestor = np.empty_like(p), np.empty(10), np.empty(n, np.int64)
            particle.step(
                p, q, grid, np.array([0, 0, 0.7, 0, 0.0]), np.zeros(3), par, 0, True, pool, 0, u, est, ancestor
            )
            children += np.bincount(ancestor, minlength=n)
            weights = p[14]
        np.testing.assert_allclose(children / trials, n * weights, atol=2e-3)

    def test_impossible_weights_leave_the_particles_alone(self, rng: np.random.Generator) -> None:
        """A reading no particle can explain must not divide by zero."""
        n = 100
        p, grid = _particles(rng, n), _grid(rng)
        grid[..., 6] = 0.0
        q, est, ancestor = np.empty_like(p), np.empty(10), np.empty(n, np.int64)
        pool = rng.standard_normal(4 * n).astype(np.float32)
        particle.step(p, q, grid, MOTION, np.zeros(3), PAR, 0, True, pool, 0, 0.5, est, ancestor)
        assert np.isfinite(est).all()
        np.testing.assert_allclose(p[14], 1.0 / n)


class TestSteps:
    def test_agrees_with_full_windows(self, rng: np.random.Generator) -> None:
        t = np.arange(0, 20, 0.02)
        walk = 2.0 * np.sin(2 * np.pi * 1.8 * t) * (t > 3) * (t < 15) + 0.4 * rng.standard_normal(t.shape)
        m = step_module
        found = m.find_steps(t, 9.81 + walk).t
        expected = naive.steps(
            t, 9.81 + walk, m.SMOOTH_S, m.PEAK_S, m.SWING_S, m.MIN_SWING, m.MIN_INTERVAL_S, m.SETTLE_S
        )
        np.testing.assert_array_equal(found, expected)
        assert 18 <= len(found) <= 24

    @pytest.mark.parametrize("n", [0, 1, 2, 5])
    def test_short_input_has_no_steps(self, n: int) -> None:
        assert len(step_module.find_steps(np.arange(float(n)), np.ones(n))) == 0

    def test_rest_has_no_steps(self, rng: np.random.Generator) -> None:
        t = np.arange(0, 10, 0.02)
        assert len(step_module.find_steps(t, 9.81 + 0.1 * rng.standard_normal(t.shape))) == 0


class TestWindows:
    def test_pauta_means_agree(self, rng: np.random.Generator) -> None:
        values = rng.standard_normal((200, 3))
        values[rng.integers(0, 200, 12), rng.integers(0, 3, 12)] += 60.0
        lo = rng.integers(0, 180, 50)
        hi = lo + rng.integers(1, 20, 50)
        out = np.empty((50, 3))
        pauta_means(values, lo, hi, out)
        np.testing.assert_allclose(out, naive.pauta_means(values, lo, hi))

    @pytest.mark.parametrize("n", [1, 2, 3])
    def test_constant_and_tiny_windows(self, n: int) -> None:
        out = np.empty((1, 1))
        pauta_means(np.full((n, 1), 7.0), np.array([0]), np.array([n]), out)
        assert out[0, 0] == 7.0

    def test_a_spike_does_not_move_the_mean(self) -> None:
        t = np.arange(0, 1, 0.02)
        values = np.full((50, 1), 30.0)
        values[25] = 500.0
        assert window_means(t, values, np.array([0.3]), np.array([0.7]))[0, 0] == pytest.approx(30.0)
