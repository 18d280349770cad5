"""Contour kernels against their slow twins, on random, degenerate and adversarial input."""

from __future__ import annotations

import os

import numpy as np
import pytest

from app.engine.kernels import contour
from app.engine.kernels.lanes_contour import LANES, ROWS
from app.engine.kernels.lanes_contour import lattice_difference as difference_in_lanes
from tests.reference import naive

LATTICES = ["random", "one point", "on nodes", "half way", "constant", "nothing mapped", "large"]


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


class _Lattice:
    """Arguments of the lattice kernels."""

    def __init__(self, rng: np.random.Generator, kind: str, shape: tuple[int, int]) -> None:
        n = {"one point": 1, "large": 60}.get(kind, 9)
        self.shape = shape
        self.plane = (10.0 * rng.standard_normal((shape[0] + 12, shape[1] + 15))).astype(np.float32)
        if kind == "constant":
            self.plane[:] = 42.0
        self.weight = rng.choice(np.array([0.0, 0.5, 1.0], dtype=np.float32), self.plane.shape)
        if kind == "nothing mapped":
            self.weight[:] = 0.0
        self.offset = rng.standard_normal(shape).astype(np.float32)
        self.i, self.j = rng.integers(0, 11, n), rng.integers(0, 14, n)
        self.v, self.u = (rng.uniform(0.0, 1.0, n).astype(np.float32) for _ in range(2))
        if kind in ("on nodes", "half way"):
            self.v[:] = self.u[:] = 0.0 if kind == "on nodes" else 0.5
        self.z = (10.0 * rng.standard_normal(n)).astype(np.float32)

    @property
    def place(self) -> tuple[np.ndarray, ...]:
        return self.i, self.j, self.v, self.u

    def naive(self, *, weighted: bool = True, moved: bool = True) -> tuple[np.ndarray, ...]:
        weight = self.weight if weighted else np.ones_like(self.weight)
        offset = self.offset if moved else np.zeros_like(self.offset)
        return naive.lattice(self.plane, weight, offset, *self.place, self.z, self.shape)


@pytest.mark.parametrize("kind", LATTICES)
class TestLattice:
    @pytest.mark.parametrize("squared", [False, True])
    def test_differences(self, rng: np.random.Generator, kind: str, squared: bool) -> None:
        one = _Lattice(rng, kind, (5, 7))
        total = np.ones(one.shape, dtype=np.float32)
        contour.lattice_difference(one.plane, one.weight, one.offset, *one.place, one.z, squared, total)
        s, w, z = one.naive()
        expected = 1.0 + (w * ((s - z) ** 2 if squared else np.abs(s - z))).sum(axis=2)
        np.testing.assert_allclose(total, expected, rtol=1e-5, atol=1e-3)

    @pytest.mark.skipif("NUMBA_DISABLE_JIT" in os.environ, reason="lanes exist only compiled")
    @pytest.mark.parametrize("squared", [False, True])
    @pytest.mark.parametrize("weighted", [False, True])
    @pytest.mark.parametrize("moved", [False, True])
    def test_differences_in_lanes(
        self, rng: np.random.Generator, kind: str, squared: bool, weighted: bool, moved: bool
    ) -> None:
        one = _Lattice(rng, kind, (2 * ROWS, 3 * LANES))
        total, stride = np.ones(one.shape, dtype=np.float32), one.plane.shape[1]
        near = (one.i + (one.v > 0.5)) * stride + one.j + (one.u > 0.5)
        difference_in_lanes(
            one.plane,
            one.weight if weighted else None,
            one.offset if moved else None,
            one.i * stride + one.j,
            near,
            one.v,
            one.u,
            one.z,
            squared,
            total,
        )
        s, w, z = one.naive(weighted=weighted, moved=moved)
        expected = 1.0 + (w * ((s - z) ** 2 if squared else np.abs(s - z))).sum(axis=2)
        np.testing.assert_allclose(total, expected, rtol=1e-5, atol=1e-3)

    def test_weights(self, rng: np.random.Generator, kind: str) -> None:
        one = _Lattice(rng, kind, (5, 7))
        total = np.ones(one.shape, dtype=np.float32)
        contour.lattice_weight(one.weight, *one.place, total)
        np.testing.assert_allclose(total, 1.0 + one.naive()[1].sum(axis=2), rtol=1e-6)

    def test_moments(self, rng: np.random.Generator, kind: str) -> None:
        one = _Lattice(rng, kind, (5, 7))
        total = np.zeros((5, *one.shape), dtype=np.float32)
        contour.lattice_moments(one.plane, one.weight, *one.place, one.z, total)
        s, w, z = one.naive(moved=False)
        expected = [(w * part).sum(axis=2) for part in (s, s * s, s * z, z, z * z)]
        np.testing.assert_allclose(total, expected, rtol=1e-4, atol=1e-2)


def test_the_lowest_of_several_costs_is_kept_with_its_number(rng: np.random.Generator) -> None:
    costs = rng.standard_normal((4, 6, 9)).astype(np.float32)
    costs[2, 1, 1] = costs[0, 1, 1] = -9.0  # of equals the first
    costs[:, 0, 0] = np.inf
    lowest, which = np.full((6, 9), np.inf, dtype=np.float32), np.full((6, 9), -1)
    for k, cost in enumerate(costs):
        contour.keep_lowest(cost, k, lowest, which)
    np.testing.assert_array_equal(lowest, costs.min(axis=0))
    which[0, 0] = 0 if which[0, 0] == -1 else -1
    np.testing.assert_array_equal(which, costs.argmin(axis=0))
