"""Contour kernels against their slow twins, on random, degenerate and adversarial input."""

from __future__ import annotations

import numpy as np
import pytest

from app.engine.kernels import contour
from tests.reference import naive


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(11)


class TestPlacements:
    @pytest.mark.parametrize("channels", [1, 2, 3])
    @pytest.mark.parametrize("squared", [False, True])
    @pytest.mark.parametrize("centred", [False, True])
    @pytest.mark.parametrize("turning", [False, True])
    def test_agree_with_point_after_point(
        self, rng: np.random.Generator, channels: int, squared: bool, centred: bool, turning: bool
    ) -> None:
        if turning and channels < 2:
            pytest.skip("no vector")
        planes, support = _map(rng, channels, (9, 13))
        points, values = rng.uniform(-4.0, 4.0, (7, 2)), 5.0 * rng.standard_normal((7, channels))
        poses = np.column_stack(
            [rng.uniform(-3, 15, 40), rng.uniform(-3, 12, 40), rng.uniform(-4, 4, 40), rng.uniform(0.5, 2, 40)]
        )
        poses[:3] = [[0, 0, 0, 1], [12, 8, 0, 1], [6, 4, 0, 0]]  # corners, and all points on one node
        self._compare(planes, support, points, values, poses, squared, centred, turning)

    def test_maps_of_one_node_and_tracks_of_one_point(self, rng: np.random.Generator) -> None:
        for shape in ((1, 1), (1, 5), (5, 1)):
            planes, support = _map(rng, 2, shape)
            poses = np.column_stack([rng.integers(0, 5, (20, 2)), np.zeros(20), np.ones(20)]).astype(float)
            self._compare(planes, support, np.zeros((1, 2)), np.ones((1, 2)), poses, False, False, False)

    def test_far_off_and_not_a_number_are_unmapped(self, rng: np.random.Generator) -> None:
        planes, support = _map(rng, 1, (5, 5))
        poses = np.array([[1e300, 0, 0, 1], [np.nan, 2, 0, 1], [2, -1e18, 0, 1]])
        cost, mapped = _placements(planes, support, np.zeros((3, 2)), np.zeros((3, 1)), poses, True, True, False)
        assert not cost.any()
        assert not mapped.any()

    def _compare(self, planes, support, points, values, poses, squared, centred, turning) -> None:  # type: ignore[no-untyped-def]
        cost, mapped = _placements(planes, support, points, values, poses, squared, centred, turning)
        expected = naive.placements(planes, support <= 1.0, points, values, poses, squared, centred, turning)
        np.testing.assert_allclose(np.stack([cost, mapped], axis=1), expected, rtol=1e-5, atol=1e-5)


def _map(rng: np.random.Generator, channels: int, shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    planes = (30.0 * rng.standard_normal((channels, *shape))).astype(np.float32)
    return planes, rng.choice(np.array([0.5, 2.0], dtype=np.float32), shape, p=[0.8, 0.2])


def _placements(planes, support, points, values, poses, squared, centred, turning):  # type: ignore[no-untyped-def]
    cost, mapped = np.empty(len(poses)), np.empty(len(poses))
    scratch = np.empty((len(planes), len(points)))
    contour.placements_mad(
        planes, support, 1.0, points, values, poses, squared, centred, turning, scratch, cost, mapped
    )
    return cost, mapped
