"""Probabilities of polygons against Monte Carlo, products of one-dimensional ones, and laws."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import ndtr

from app.engine.errors import InputError
from app.engine.geofencing import MIN_AREA_M2, inside_probability, signed_area, simple_ring
from app.engine.types import Float64Array

SQUARE = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.0]])
U_SHAPE = np.array([[0, 0], [9, 0], [9, 6], [6, 6], [6, 2], [3, 2], [3, 6], [0, 6]], dtype=float)
SPIKED = np.array([[0, 0], [5, -1], [10, 0], [7, 3], [9, 9], [4, 5], [-2, 8], [1, 4]], dtype=float)


def probability(ring: Float64Array, x: float, y: float, xx: float, xy: float, yy: float) -> float:
    return float(inside_probability(ring, np.array([[x, y]]), np.array([[xx, xy, yy]]))[0])


def contains(ring: Float64Array, points: Float64Array) -> np.ndarray:
    """Even-odd rule, one edge after the other."""
    inside = np.zeros(len(points), dtype=bool)
    for (ax, ay), (bx, by) in zip(ring, np.roll(ring, -1, axis=0), strict=True):
        spans = (ay > points[:, 1]) != (by > points[:, 1])
        if spans.any():
            at = ax + (points[:, 1] - ay) / (by - ay) * (bx - ax)
            inside ^= spans & (points[:, 0] < at)
    return inside


@pytest.mark.parametrize("ring", [SQUARE, U_SHAPE, SPIKED], ids=["square", "u", "spiked"])
@pytest.mark.parametrize(
    ("mean", "cov"),
    [
        ((2.0, 2.0), (1.0, 0.0, 1.0)),
        ((4.5, 4.0), (4.0, 1.5, 0.8)),
        ((0.0, 0.0), (2.0, -1.2, 3.0)),
        ((-3.0, 5.0), (9.0, 0.0, 0.5)),
        ((4.5, 4.0), (0.01, 0.0, 0.01)),
    ],
)
def test_agrees_with_monte_carlo(
    ring: Float64Array, mean: tuple[float, float], cov: tuple[float, float, float]
) -> None:
    n = 200_000
    matrix = [[cov[0], cov[1]], [cov[1], cov[2]]]
    points = np.random.default_rng(5).multivariate_normal(mean, matrix, n)
    drawn = contains(ring, points).mean()
    found = probability(ring, *mean, *cov)
    assert found == pytest.approx(drawn, abs=4.5 * np.sqrt(max(drawn * (1 - drawn), 1 / n) / n))


@settings(max_examples=100)
@given(st.floats(-8, 12), st.floats(-8, 12), st.floats(0.05, 5), st.floats(0.05, 5))
def test_a_rectangle_is_a_product(x: float, y: float, sd_x: float, sd_y: float) -> None:
    def between(low: float, high: float, mean: float, sd: float) -> float:
        return float(ndtr((high - mean) / sd) - ndtr((low - mean) / sd))

    expected = between(0.0, 4.0, x, sd_x) * between(0.0, 4.0, y, sd_y)
    assert probability(SQUARE, x, y, sd_x**2, 0.0, sd_y**2) == pytest.approx(expected, abs=1e-12)


@settings(max_examples=50)
@given(st.floats(-1e5, 1e5), st.floats(-1e5, 1e5), st.floats(0, 6.28))
def test_moving_and_turning_everything_changes_nothing(dx: float, dy: float, angle: float) -> None:
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    cov = np.array([[2.0, 0.7], [0.7, 0.9]])
    mean = np.array([3.1, 4.0])
    turned, moved = turn @ cov @ turn.T, turn @ mean + (dx, dy)
    there = probability(U_SHAPE @ turn.T + (dx, dy), *moved, turned[0, 0], turned[0, 1], turned[1, 1])
    assert there == pytest.approx(probability(U_SHAPE, *mean, 2.0, 0.7, 0.9), abs=1e-8)


@given(st.floats(-10, 20), st.floats(-10, 20), st.floats(0.0, 30.0))
def test_two_halves_make_the_whole(x: float, y: float, variance: float) -> None:
    """Also where a mean lies on an edge or a vertex, and without any variance."""
    cov = (variance, 0.3 * variance, variance)
    left, right = (np.array([[a, 0.0], [a + 2.0, 0.0], [a + 2.0, 4.0], [a, 4.0]]) for a in (0.0, 2.0))
    halves = probability(left, x, y, *cov) + probability(right, x, y, *cov)
    assert halves == pytest.approx(probability(SQUARE, x, y, *cov), abs=1e-9)


def test_edges_and_corners_are_half_and_quarter() -> None:
    assert probability(SQUARE, 0.0, 2.0, 1e-4, 0.0, 1e-4) == pytest.approx(0.5, abs=1e-9)
    assert probability(SQUARE, 0.0, 0.0, 1e-4, 0.0, 1e-4) == pytest.approx(0.25, abs=1e-9)
    assert probability(SQUARE, 2.0, 2.0, 0.0, 0.0, 0.0) == pytest.approx(1.0, abs=1e-12)
    assert probability(SQUARE, 500.0, 2.0, 1.0, 0.0, 1.0) == 0.0


def test_many_positions_at_once_and_either_way_round() -> None:
    rng = np.random.default_rng(1)
    means = rng.uniform(-3, 12, (40, 2))
    covs = np.column_stack([rng.uniform(0.5, 9, 40), rng.uniform(-0.5, 0.5, 40), rng.uniform(0.5, 9, 40)])
    together = inside_probability(SPIKED, means, covs)
    assert together == pytest.approx([probability(SPIKED, *m, *c) for m, c in zip(means, covs, strict=True)], abs=1e-12)
    assert inside_probability(SPIKED[::-1], means, covs) == pytest.approx(together, abs=1e-12)
    assert together.min() < 0.1
    assert together.max() > 0.6


def test_a_covariance_that_is_none_by_rounding_is_taken() -> None:
    assert 0.0 <= probability(SQUARE, 2.0, 2.0, 1.0, 1.0 + 1e-12, 1.0) <= 1.0


def test_rings_come_counter_clockwise_and_open() -> None:
    closed = np.vstack([SQUARE[::-1], SQUARE[-1:]])
    ring = simple_ring("polygon", closed)
    assert signed_area(ring) == 16.0
    assert ring.shape == (4, 2)
    assert signed_area(SQUARE + 1e6) == pytest.approx(16.0, abs=1e-6)
    for shape in (U_SHAPE, SPIKED):
        assert simple_ring("polygon", shape) == pytest.approx(shape)


@pytest.mark.parametrize(
    ("points", "word"),
    [
        ([[0, 0], [4, 0]], "vertices"),
        ([[0, 0], [4, 0], [0, 0]], "vertices"),
        ([[np.cos(a), np.sin(a)] for a in np.linspace(0, 6.2, 201)], "vertices"),
        ([[0, 0], [4, 0], [4, 0], [0, 4]], "same point"),
        ([[0, 0], [4, 4], [4, 0], [0, 4]], "crosses"),
        ([[0, 0], [4, 0], [4, 4], [2, 0], [0, 4]], "crosses or touches"),
        ([[0, 0], [4, 0], [2, 0], [2, 3]], "crosses or touches"),
        ([[0, 0], [4, 0], [8, 0]], "touches"),
        ([[0, 0], [MIN_AREA_M2, 0], [MIN_AREA_M2, 0.9], [0, 0.9]], "area"),
        ([[0, 0], [np.nan, 0], [1, 1]], "points"),
        ([[0, 0, 0], [1, 0, 0], [1, 1, 0]], "points"),
    ],
)
def test_what_is_no_simple_polygon_is_refused(points: list[list[float]], word: str) -> None:
    with pytest.raises(InputError, match=word) as caught:
        simple_ring("polygon", np.array(points, dtype=float))
    assert caught.value.field == "polygon"
