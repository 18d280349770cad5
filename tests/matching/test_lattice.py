"""Costs over lattices of shifts are those of the formulas at each shift."""

from __future__ import annotations

import numpy as np
import pytest

from app.engine.matching.criteria import Criterion, as_cost, centred, evaluate
from app.engine.matching.lattice import LatticeMap
from app.engine.matching.peaks import descend, local_minima

SHAPE = (6, 9)


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(6)


def read(planes: np.ndarray, row: np.ndarray, column: np.ndarray) -> np.ndarray:
    """Bilinear, the edge's value beyond it; (n, channels)."""
    rows, columns = planes.shape[1:]
    i, j = np.floor(row).astype(int), np.floor(column).astype(int)
    v, u = row - i, column - j
    corner = [
        planes[:, np.clip(i + a, 0, rows - 1), np.clip(j + b, 0, columns - 1)]
        for a, b in ((0, 0), (0, 1), (1, 0), (1, 1))
    ]
    return ((1 - v) * ((1 - u) * corner[0] + u * corner[1]) + v * ((1 - u) * corner[2] + u * corner[3])).T


@pytest.mark.parametrize("criterion", Criterion)
@pytest.mark.parametrize("centre", [False, True])
@pytest.mark.parametrize("holes", [False, True])
def test_each_shift_by_the_formula(rng: np.random.Generator, criterion: Criterion, centre: bool, holes: bool) -> None:
    planes = (np.array([0.0, 40.0])[:, None, None] + 5.0 * rng.standard_normal((2, 30, 40))).astype(np.float32)
    mapped = rng.uniform(size=(30, 40)) > 0.3 if holes else np.ones((30, 40), dtype=bool)
    row, column = rng.uniform(3.0, 12.0, 11), rng.uniform(-2.0 if holes else 4.0, 12.0, 11)
    values = np.array([2.0, 38.0]) + 5.0 * rng.standard_normal((11, 2))
    lattice = LatticeMap.of(
        planes,
        mapped,
        pitch=1,
        reference=values.mean(axis=0),
        low=(row.min(), column.min()),
        high=(row.max() + SHAPE[0] - 1, column.max() + SHAPE[1] - 1),
    )
    found = lattice.costs(lattice.points(row, column, values), SHAPE, criterion, centre=centre, mapped=0.5)
    expected = np.empty(SHAPE)
    for y, x in np.ndindex(SHAPE):
        at = np.floor(row + y + 0.5).astype(int), np.floor(column + x + 0.5).astype(int)
        inside = (at[0] >= 0) & (at[0] < 30) & (at[1] >= 0) & (at[1] < 40)
        weight = (inside & mapped[np.clip(at[0], 0, 29), np.clip(at[1], 0, 39)]).astype(float)
        readings = read(planes, row + y, column + x)
        compared = centred(values, readings, weight) if centre else values
        cost = float(as_cost(criterion, evaluate(criterion, compared, readings, weight)))
        expected[y, x] = cost if weight.sum() >= 0.5 * 11 else np.inf
    np.testing.assert_allclose(found, expected, rtol=2e-4, atol=1e-4)
    assert np.isinf(found).any() == np.isinf(expected).any()


def test_a_coarse_map_holds_means_of_mapped_cells(rng: np.random.Generator) -> None:
    planes, mapped = rng.standard_normal((1, 8, 8)).astype(np.float32), np.ones((8, 8), dtype=bool)
    mapped[2:4, 2:4] = [[True, False], [False, False]]
    lattice = LatticeMap.of(planes, mapped, pitch=2, reference=np.array([1.0]), low=(2.0, 2.0), high=(5.0, 5.0))
    assert (lattice.row0, lattice.column0) == (0.5, 0.5)
    assert lattice.planes[0, 0, 0] == pytest.approx(planes[0, :2, :2].mean() - 1.0, rel=1e-5)
    assert lattice.planes[0, 1, 1] == pytest.approx(planes[0, 2, 2] - 1.0, rel=1e-5)
    assert lattice.weight[1, 1] == 0.25
    assert not lattice.whole


def test_minima_are_lower_than_their_neighbours(rng: np.random.Generator) -> None:
    cost = rng.standard_normal((12, 15))
    cost[3, 3] = -np.inf  # no cost: no place
    found = local_minima(cost, 100)
    for y, x in found:
        assert cost[y, x] == cost[max(y - 1, 0) : y + 2, max(x - 1, 0) : x + 2].min()
    assert (np.diff(cost[found[:, 0], found[:, 1]]) >= 0.0).all()
    assert len(local_minima(cost, 3)) == 3
    assert len(local_minima(np.full((4, 4), np.inf), 3)) == 0


def test_a_quadratic_is_solved_at_once_and_bounds_hold() -> None:
    bottom, shape = np.array([0.3, -0.2, 0.1]), np.array([[3.0, 1.0, 0.5], [1.0, 2.0, 0.2], [0.5, 0.2, 1.0]])

    def cost(places: np.ndarray) -> np.ndarray:
        away = places[:, :3] - bottom
        return np.einsum("pi,ij,pj->p", away, shape, away) + places[:, 3]

    step, wide = np.array([0.5, 0.5, 0.5, 0.0]), np.full(4, 9.0)
    places, costs, asked = descend(cost, np.zeros((2, 4)), step, -wide, wide, iterations=1)
    np.testing.assert_allclose(places, [[*bottom, 0.0]] * 2, atol=1e-9)
    np.testing.assert_allclose(costs, 0.0, atol=1e-12)
    assert asked == 2 * 11
    bounded, _, _ = descend(cost, np.zeros((1, 4)), step, -wide, np.array([0.1, 9.0, 9.0, 9.0]), iterations=8)
    assert bounded[0, 0] <= 0.1


def test_descent_never_ends_higher(rng: np.random.Generator) -> None:
    def rough(places: np.ndarray) -> np.ndarray:
        return np.sin(5.0 * places).sum(axis=1) + np.where(places[:, 0] > 2.0, np.inf, 0.0)

    start = rng.uniform(-2.0, 2.0, (30, 2))
    _, costs, _ = descend(rough, start, np.array([0.3, 0.3]), np.full(2, -9.0), np.full(2, 9.0), iterations=6)
    assert (costs <= rough(start)).all()
    assert (costs <= -1.3).all()  # the bottoms are at -2, but for those that the wall cuts off
    assert np.mean(costs < -1.999) > 0.8
