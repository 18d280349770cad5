"""Kriging kernels against dense solves, on random, degenerate and adversarial input."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numba import config

from app.engine.kernels.kriging import krige_blocks, krige_gradient_blocks
from app.engine.kernels.neighbours import spread_out
from app.engine.mapping import Covariance, FieldLevel, FieldSamples, krige, krige_grid, krige_nodes
from app.engine.types import Float64Array
from tests.reference import naive
from tests.support.walks import Field

COVARIANCE = Covariance(length_m=3.0, error=0.4, error_length_m=1.5, white=0.05, fine=0.4, fine_length_m=1.0)
STRETCHED = replace(COVARIANCE, stretch=1.7, stretch_angle=0.6)


whole_grids = pytest.mark.skipif(bool(config.DISABLE_JIT), reason="takes minutes without the compiler")


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(7)


def _draw(rng: np.random.Generator, n: int, channels: int) -> tuple[Float64Array, ...]:
    """Samples of three walks with noise of their own, and nodes about them."""
    xy, nodes = rng.uniform(0, 10, (n, 2)), rng.uniform(-1, 11, (12, 2))
    error, white = rng.uniform(0.3, 0.9, n), rng.uniform(0.02, 0.2, n)
    return xy, rng.integers(0, 3, n), rng.standard_normal((n, channels)), error, white, nodes


def _run(kernel, drawn, covariance: Covariance, columns: int, kind: type = np.float64) -> tuple[Float64Array, ...]:
    xy, walk, z, error, white, nodes = drawn
    n, shape = len(xy), covariance.to_isotropic()
    mean, var = np.empty((12, z.shape[1])), np.empty((12, columns))
    nb = np.arange(n)[None].repeat(2, axis=0)
    parameters = covariance.kernel_parameters().astype(kind)
    kernel(
        xy @ shape, walk, z.astype(kind), error.astype(kind), white.astype(kind), nb, np.array([n, n]), nodes @ shape,
        np.array([0, 5, 12]), parameters, mean, var,
    )  # fmt: skip
    return mean, var


class TestBlocks:
    @pytest.mark.parametrize("channels", [1, 3])
    @pytest.mark.parametrize("n", [1, 2, 40])
    @pytest.mark.parametrize("covariance", [COVARIANCE, replace(COVARIANCE, fine=0.0), STRETCHED])
    def test_one_block_is_the_dense_solution(
        self, rng: np.random.Generator, n: int, channels: int, covariance: Covariance
    ) -> None:
        drawn = _draw(rng, n, channels)
        mean, var = _run(krige_blocks, drawn, covariance, 1)
        expected_mean, expected_var = naive.krige(*drawn, covariance)
        np.testing.assert_allclose(mean, expected_mean, atol=1e-8)
        np.testing.assert_allclose(var[:, 0], expected_var, atol=1e-8)

    def test_single_precision_is_enough(self, rng: np.random.Generator) -> None:
        drawn = _draw(rng, 90, 3)
        mean, var = _run(krige_blocks, drawn, COVARIANCE, 1, np.float32)
        expected_mean, expected_var = naive.krige(*drawn, COVARIANCE)
        np.testing.assert_allclose(mean, expected_mean, atol=1e-4)
        np.testing.assert_allclose(var[:, 0], expected_var, atol=1e-4)

    def test_without_neighbours_nothing_is_known(self) -> None:
        mean, var = np.empty((2, 1)), np.empty((2, 1))
        one = np.ones(1)
        krige_blocks(
            np.zeros((1, 2)), np.zeros(1, np.int64), np.ones((1, 1)), one, one, np.zeros((1, 1), np.int64),
            np.array([0]), np.zeros((2, 2)), np.array([0, 2]), Covariance().kernel_parameters(), mean, var,
        )  # fmt: skip
        assert (mean == 0).all()
        assert (var == 1).all()

    @pytest.mark.parametrize("kernel", [krige_blocks, krige_gradient_blocks])
    def test_repeated_samples_stay_finite(self, kernel) -> None:
        n, columns = 30, 1 if kernel is krige_blocks else 2
        mean, var = np.empty((1, 2)), np.empty((1, columns))
        kernel(
            np.zeros((n, 2)), np.zeros(n, np.int64), np.ones((n, 2)), np.zeros(n), np.zeros(n), np.arange(n)[None],
            np.array([n]), np.zeros((1, 2)), np.array([0, 1]), Covariance().kernel_parameters(), mean, var,
        )  # fmt: skip
        assert np.isfinite(mean).all()
        assert (var > 0).all()


class TestGradient:
    @pytest.mark.parametrize("n", [1, 2, 30])
    @pytest.mark.parametrize("covariance", [COVARIANCE, replace(COVARIANCE, fine=0.0), STRETCHED])
    def test_one_block_is_the_dense_solution(self, rng: np.random.Generator, n: int, covariance: Covariance) -> None:
        drawn = _draw(rng, n, 2)
        mean, var = _run(krige_gradient_blocks, drawn, covariance, 2)
        expected_mean, expected_var = naive.krige_gradient(*drawn, covariance)
        # the twin differentiates numerically; Matern 5/2 has a kink in its third derivative at lag zero
        np.testing.assert_allclose(mean, expected_mean, atol=1e-2)
        np.testing.assert_allclose(var, expected_var, atol=5e-3)

    def test_the_mean_has_no_curl(self, rng: np.random.Generator) -> None:
        xy, walk = rng.uniform(0, 10, (60, 2)), rng.integers(0, 6, 60)
        samples = FieldSamples(xy, walk, rng.standard_normal((60, 3)))
        centre, h = rng.uniform(2, 8, (20, 2)), 0.05

        def at(dx: float, dy: float, covariance: Covariance) -> Float64Array:
            level = FieldLevel(np.zeros(3), np.sqrt([*covariance.gradient_sills, 1.0]))
            return krige(samples, level, covariance, centre + np.array([dx, dy]), neighbours=60)[0]

        def curl(covariance: Covariance) -> Float64Array:
            slope_x = at(h, 0.0, covariance) - at(-h, 0.0, covariance)
            slope_y = at(0.0, h, covariance) - at(0.0, -h, covariance)
            return (slope_x[:, 1] - slope_y[:, 0]) / (2.0 * h)

        smooth = Covariance(length_m=8.0, fine=0.0, error=0.4)
        free, bound = curl(smooth), curl(replace(smooth, curl_free=True, stretch=1.5, stretch_angle=1.0))
        assert np.abs(bound).max() < 0.03 * np.abs(free).max()


@whole_grids
class TestGrid:
    @pytest.fixture
    def samples(self, rng: np.random.Generator) -> FieldSamples:
        xy = rng.uniform(0, 20, (400, 2))
        return FieldSamples(xy, rng.integers(0, 12, 400), Field.random(rng, sd=1.0).at(xy) - [3.0, 30.0, -30.0])

    @pytest.mark.parametrize("curl_free", [False, True])
    def test_some_nodes_get_what_all_would(self, samples: FieldSamples, rng, *, curl_free: bool) -> None:
        level, covariance = FieldLevel(np.zeros(3), np.ones(3)), Covariance(curl_free=curl_free)
        x, y = 0.5 * np.arange(-7, 50), 0.5 * np.arange(3, 41)
        mean, sd = krige_grid(samples, level, covariance, x, y)
        where = rng.random(mean.shape[1:]) < 0.03
        some_mean, some_sd = krige_nodes(samples, level, covariance, x, y, where)
        np.testing.assert_allclose(some_mean, mean[:, where], atol=1e-4)
        np.testing.assert_allclose(some_sd, sd[:, where], atol=1e-4)
        wider = krige_grid(samples, level, covariance, 0.5 * np.arange(-9, 50), y)[0]
        np.testing.assert_allclose(wider[:, :, 2:], mean, atol=1e-4)

    def test_blocks_are_as_good_as_nodes(self, samples: FieldSamples) -> None:
        """A neighbourhood serves its whole block: what it costs is small beside the deviation."""
        level, axis = FieldLevel(np.zeros(3), np.ones(3)), 0.5 * np.arange(1, 40)
        mean, sd = krige_grid(samples, level, Covariance(), axis, axis)
        nodes = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
        alone, _ = krige(samples, level, Covariance(), nodes, neighbours=400)
        assert np.sqrt(((mean.reshape(3, -1).T - alone) ** 2).mean()) < 0.05 * sd.mean()

    def test_a_raising_progress_ends_the_work(self, samples: FieldSamples) -> None:
        def stop(_fraction: float, _what: str) -> None:
            raise InterruptedError

        level, axis = FieldLevel(np.zeros(3), np.ones(3)), 0.5 * np.arange(40)
        values = samples.values.copy()
        with pytest.raises(InterruptedError):
            krige_grid(samples, level, Covariance(), axis, axis, progress=stop)
        np.testing.assert_array_equal(samples.values, values)

    def test_nothing_asked_nothing_kriged(self, samples: FieldSamples) -> None:
        level, axis = FieldLevel(np.zeros(3), np.ones(3)), 0.5 * np.arange(40)
        mean, sd = krige_nodes(samples, level, Covariance(), axis, axis, np.zeros((40, 40), dtype=bool))
        assert mean.shape == sd.shape == (3, 0)


class TestNeighbours:
    @pytest.mark.parametrize("spacing", [0.0, 0.7, 100.0])
    @pytest.mark.parametrize("n", [1, 7, 60])
    def test_as_chosen_one_by_one(self, rng: np.random.Generator, spacing: float, n: int) -> None:
        xy, walk = rng.uniform(0, 5, (n, 2)), rng.integers(0, 4, n)
        near = np.argsort(np.hypot(*(xy - 2.5).T))[None]
        chosen, count = np.zeros((1, min(n, 20)), np.int64), np.empty(1, np.int64)
        spread_out(xy, walk, near, np.array([n]), spacing, chosen, count)
        assert chosen[0, : count[0]].tolist() == naive.spread_out(xy, walk, near[0].tolist(), spacing, min(n, 20))


@whole_grids
class TestAgainstExact:
    """Blocks and neighbourhoods against one dense solve with all samples, on a drawn field of the very covariance."""

    @pytest.mark.parametrize("curl_free", [False, True])
    def test_error_within_three_percent(self, rng: np.random.Generator, *, curl_free: bool) -> None:
        covariance = Covariance(length_m=5.0, fine_length_m=1.5, error=0.2, white=0.1, curl_free=curl_free)
        axis = 0.5 * np.arange(24)
        nodes = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
        lines = np.arange(0.5, 12.0, 2.0)
        along = np.arange(0.2, 11.8, 0.4)
        xy = np.concatenate([[(s, y) for s in along] for y in lines] + [[(x, s) for s in along] for x in lines])
        walk = np.repeat(np.arange(12), len(along))
        error, white = np.full(len(xy), np.sqrt(0.2)), np.full(len(xy), 0.1)
        z, truth = self._draw(rng, xy, nodes, walk, covariance)
        z = z + rng.multivariate_normal(np.zeros(len(xy)), naive.sample_noise(xy, walk, error, white, covariance), 2).T
        level = FieldLevel(np.zeros(2), np.ones(2))
        ours, sd = krige_grid(FieldSamples(xy, walk, z), level, covariance, axis, axis)
        exact = (naive.krige_gradient if curl_free else naive.krige)(xy, walk, z, error, white, nodes, covariance)
        rmse = np.sqrt(((ours.reshape(2, -1).T - truth) ** 2).mean())
        assert rmse < 1.03 * np.sqrt(((exact[0] - truth) ** 2).mean())
        ratio = sd.reshape(2, -1).T / np.sqrt(exact[1].reshape(len(nodes), -1))
        assert ratio.min() > 0.99  # fewer samples never make it surer
        assert ratio.mean() < 1.03

    def _draw(self, rng, xy, nodes, walk, covariance: Covariance) -> tuple[Float64Array, Float64Array]:
        """Field at samples and nodes, (n, 2) and (m, 2)."""
        at = np.concatenate([xy, nodes])
        n = len(at)
        lags = (at[:, None] - at[None]).reshape(-1, 2)
        if covariance.curl_free:
            c = naive.gradient_covariance(lags, covariance).reshape(n, n, 2, 2).transpose(2, 0, 3, 1)
            c = c.reshape(2 * n, 2 * n)
        else:
            c = np.kron(np.eye(2), naive.nested(np.linalg.norm(lags, axis=-1), covariance).reshape(n, n))
        factor = np.linalg.cholesky(c + 1e-4 * np.eye(2 * n))
        drawn = (factor @ rng.standard_normal(2 * n)).reshape(2, n).T
        return drawn[: len(xy)], drawn[len(xy) :]
