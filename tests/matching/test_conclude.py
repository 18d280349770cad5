"""What is claimed of a placement holds, whatever method found it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from app.engine.errors import InputError
from app.engine.matching import Candidate, MatchProblem, conclude, read_map, route_along
from app.engine.types import FeatureSet, Status
from tests.support.fields import Truth, field_map, walk_through

_CHI2_95 = 5.991


def _at(truth: Truth, dx: float = 0.0, dy: float = 0.0) -> Candidate:
    return Candidate(truth.x + dx, truth.y + dy, cost=0.0)


@pytest.mark.parametrize("features", FeatureSet)
def test_the_right_place_wins(features: FeatureSet) -> None:
    rng = np.random.default_rng(1)
    truth = walk_through(field_map(rng, features=features), rng, start=(20.0, 20.0), region_sd=10.0)
    result = conclude(truth.problem, [_at(truth, 8.0), _at(truth), _at(truth, 0.0, -9.0)], evaluated=3)
    assert result.status is Status.OK
    assert truth.end_error(result.matches[0].x, result.matches[0].y) == 0.0
    assert result.matches[0].weight > 0.99
    assert result.evidence.residual_rms == pytest.approx(0.2, rel=0.3)


def test_ellipses_hold_what_they_claim() -> None:
    """Placements at the likeliest shift, by brute force: the truth lies in 95 % of the ellipses."""
    inside, n = 0, 30
    for seed in range(n):
        rng = np.random.default_rng(seed)
        grid_map = field_map(rng, features=FeatureSet.HV, shape=(120, 120), sd_ut=1e-3)
        truth = walk_through(grid_map, rng, start=(10.0, 5.0), n=30, noise_ut=2.0, region_sd=3.0, turns=1.0)
        profile = truth.problem.profile
        steps = np.linspace(-0.8, 0.8, 25)
        costs = [
            float(((read_map(grid_map, profile.features, truth.x + dx, truth.y + dy).mean - profile.values) ** 2).sum())
            for dx in steps
            for dy in steps
        ]
        dx, dy = steps[int(np.argmin(costs)) // 25], steps[int(np.argmin(costs)) % 25]
        problem = replace(
            truth.problem,
            region=replace(truth.problem.region, heading_sd=1e-6, scale_sd=1e-6),  # type: ignore[type-var]
        )
        match = conclude(problem, [_at(truth, dx, dy)], evaluated=1).matches[0]
        away = np.array([match.x[-1] - truth.x[-1], match.y[-1] - truth.y[-1]])
        inside += float(away @ np.linalg.solve(match.cov, away)) <= _CHI2_95
    assert 0.87 * n <= inside


def test_along_contours_nothing_is_claimed() -> None:
    rng = np.random.default_rng(3)
    grid_map = field_map(rng, features=FeatureSet.TOTAL)
    ridge = np.broadcast_to(grid_map.mean[:, :, :1], grid_map.mean.shape).copy()  # changes with y alone
    flat = replace(grid_map, mean=ridge)
    truth = walk_through(flat, rng, start=(20.0, 0.0), region_sd=30.0, turns=0.0)
    result = conclude(truth.problem, [_at(truth)], evaluated=1)
    assert result.status is Status.INSUFFICIENT
    assert result.evidence.information_m > 20.0
    assert result.walk_on_m is not None


def test_two_equal_places_are_told_as_two() -> None:
    rng = np.random.default_rng(4)
    grid_map = field_map(rng)
    mean = grid_map.mean.copy()
    mean[:, :, 100:] = mean[:, :, :100]
    truth = walk_through(replace(grid_map, mean=mean), rng, start=(0.0, 10.0), n=40, region_sd=40.0)
    result = conclude(truth.problem, [_at(truth), _at(truth, 50.0)], evaluated=2)
    assert result.status is Status.AMBIGUOUS
    assert min(m.weight for m in result.matches) > 0.1


def test_off_the_map_is_said() -> None:
    rng = np.random.default_rng(5)
    grid_map = field_map(rng)
    unmapped = replace(grid_map, support=np.full(grid_map.shape, 9.0, dtype=np.float32))
    truth = walk_through(unmapped, rng, start=(10.0, 10.0))
    assert conclude(truth.problem, [_at(truth)], evaluated=1).status is Status.OFF_MAP


def test_nothing_found_is_insufficient() -> None:
    rng = np.random.default_rng(6)
    truth = walk_through(field_map(rng), rng, start=(10.0, 10.0))
    result = conclude(truth.problem, [], evaluated=0)
    assert result.status is Status.INSUFFICIENT
    assert result.matches == ()


@pytest.mark.parametrize("known", [0.0, 10.0])
def test_an_offset_of_the_device_does_not_cost_the_right_place(known: float) -> None:
    rng = np.random.default_rng(7)
    truth = walk_through(
        field_map(rng, features=FeatureSet.HV), rng, start=(20.0, 20.0), offset_ut=8.0, offset_sd=known
    )
    result = conclude(truth.problem, [_at(truth)], evaluated=1)
    assert (result.evidence.residual_rms < 0.5) == (known > 0.0)


def test_the_gradient_is_that_of_the_map() -> None:
    rng = np.random.default_rng(8)
    grid_map = field_map(rng)
    x, y = rng.uniform(0.0, 60.0, 50), rng.uniform(0.0, 40.0, 50)
    step = 1e-5
    numeric = (
        read_map(grid_map, FeatureSet.VECTOR, x + step, y).mean - read_map(grid_map, FeatureSet.VECTOR, x, y).mean
    ) / step
    np.testing.assert_allclose(read_map(grid_map, FeatureSet.VECTOR, x, y).gradient[:, :, 0], numeric, atol=1e-3)


def test_routes_read_the_map_at_equal_distances() -> None:
    rng = np.random.default_rng(9)
    grid_map = field_map(rng)
    route = route_along(grid_map, np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 0.0], [10.0, 5.0]]), 0.5)
    assert route is not None
    assert len(route) == 31
    np.testing.assert_allclose(np.hypot(np.diff(route.x), np.diff(route.y)), 0.5)
    np.testing.assert_allclose(route.reversed().mean[::-1], route.mean)


def test_features_that_cannot_be_had_are_refused() -> None:
    rng = np.random.default_rng(10)
    truth = walk_through(field_map(rng, features=FeatureSet.TOTAL), rng, start=(10.0, 10.0))
    with pytest.raises(InputError, match="hv cannot be had from total"):
        truth.problem.profile.as_features(FeatureSet.HV)
    with pytest.raises(InputError, match="readings for a track"):
        MatchProblem(
            replace(truth.problem.profile, values=truth.problem.profile.values[:-1]),
            truth.problem.track,
            truth.problem.grid_map,
        )
