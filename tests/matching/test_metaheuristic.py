"""Population searches beat drawing at random with the same budget, and find the track's place, turn and stretch."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest

from app.engine.matching import MATCHERS, Matcher, MatchProblem, Track
from app.engine.matching.metaheuristic.particle_swarm import constriction
from app.engine.matching.metaheuristic.search import Search, bounds
from app.engine.types import FeatureSet, Status
from tests.support.fields import Truth, field_map, walk_through

_NAMES = ("genetic", "particle_swarm", "fish_swarm")
_SEEDS = range(6)


def _matcher(name: str, **changed: object) -> Matcher:
    entry = MATCHERS[name]
    return entry.create(replace(entry.parameters(), **changed))


def _truth(seed: int, features: FeatureSet = FeatureSet.HV, **how: object) -> Truth:
    rng = np.random.default_rng(seed)
    how = {
        "start": (20.0, 20.0),
        "shift": tuple(rng.normal(0.0, 4.0, 2)),
        "rotation": float(rng.normal(0.0, 0.1)),
        "scale": float(1.0 + rng.normal(0.0, 0.05)),
        **how,
    }
    truth = walk_through(field_map(rng, features=features), rng, **how)  # type: ignore[arg-type]
    return replace(truth, problem=replace(truth.problem, seed=seed))


@pytest.mark.parametrize("name", _NAMES)
@pytest.mark.parametrize("features", FeatureSet)
def test_better_than_random_at_the_same_budget(name: str, features: FeatureSet) -> None:
    budget, wins, found = 4000, 0, 0
    for seed in _SEEDS:
        truth = _truth(seed, features)
        drawn = Search.of(truth.problem, budget)
        at_random = float(drawn.evaluate(drawn.population(budget)).min())
        result = _matcher(name, budget=budget).match(truth.problem)
        assert result.evidence.evaluated <= budget
        wins += min(match.cost for match in result.matches) < 0.8 * at_random
        match = result.matches[0]
        found += np.hypot(match.x - truth.x, match.y - truth.y).mean() < 2.0 * truth.problem.grid_map.cell_m
    assert wins >= 5
    assert found >= 5


@pytest.mark.parametrize("name", _NAMES)
def test_without_a_region_the_whole_map_is_searched(name: str) -> None:
    found = 0
    for seed in range(4):
        truth = _truth(seed, region_sd=None, shift=(0.0, 0.0))
        track = truth.problem.track
        moved = replace(track, x=track.x - track.x[0], y=track.y - track.y[0])
        match = _matcher(name, budget=30000).match(replace(truth.problem, track=moved)).matches[0]
        found += np.hypot(match.x - truth.x, match.y - truth.y).mean() < 1.0
    assert found >= 3


def test_bounds_are_the_region_or_the_map() -> None:
    truth = _truth(1, shift=(3.0, 2.0))
    low, high = bounds(truth.problem)
    np.testing.assert_allclose(low, [-15.0, -15.0, -0.3, 0.7])
    np.testing.assert_allclose(high, [15.0, 15.0, 0.3, 1.3])
    x_min, y_min, x_max, y_max = truth.problem.grid_map.extent
    low, high = bounds(replace(truth.problem, region=None))
    np.testing.assert_allclose(low[:2] + truth.problem.track.xy[0], [x_min, y_min])
    np.testing.assert_allclose(high[:2] + truth.problem.track.xy[0], [x_max, y_max])


def test_a_swarm_begins_where_the_map_has_the_first_reading() -> None:
    truth = _truth(2, FeatureSet.TOTAL)
    search = Search.of(truth.problem, 1000)
    even, on = search.population(1000), search.population_on_contour(1000)
    cell = truth.problem.grid_map.cell_m
    right = np.array([truth.x[0], truth.y[0]]) - truth.problem.track.xy[0]
    counts = []
    for places in (even, on):
        shifts = (search.low + places * (search.high - search.low))[:, :2]
        counts.append(int((np.hypot(*(shifts - right).T) < 2.0 * cell).sum()))
    assert counts[1] > 2 * counts[0]


@pytest.mark.parametrize("name", _NAMES)
def test_the_seed_decides_and_nothing_else(name: str) -> None:
    problem = _truth(3).problem
    before = pickle.dumps(problem)
    first = _matcher(name, budget=1500).match(problem)
    second = pickle.loads(pickle.dumps(_matcher(name, budget=1500))).match(problem)
    other = _matcher(name, budget=1500).match(replace(problem, seed=99))
    assert pickle.dumps(problem) == before
    np.testing.assert_array_equal(first.matches[0].x, second.matches[0].x)
    assert not np.array_equal(first.matches[0].x, other.matches[0].x)


@pytest.mark.parametrize("name", _NAMES)
def test_a_translated_problem_has_a_translated_answer(name: str) -> None:
    problem = _truth(4).problem
    assert problem.region is not None
    moved = replace(
        problem,
        track=replace(problem.track, x=problem.track.x + 64.0, y=problem.track.y - 32.0),
        grid_map=replace(problem.grid_map, x0=problem.grid_map.x0 + 64.0, y0=problem.grid_map.y0 - 32.0),
        region=replace(problem.region, x=problem.region.x + 64.0, y=problem.region.y - 32.0),
    )
    here, there = _matcher(name).match(problem).matches[0], _matcher(name).match(moved).matches[0]
    np.testing.assert_allclose(here.x + 64.0, there.x, atol=0.05)
    np.testing.assert_allclose(here.y - 32.0, there.y, atol=0.05)


@pytest.mark.parametrize("name", _NAMES)
def test_after_the_deadline_it_answers_with_what_it_has(name: str) -> None:
    result = _matcher(name, budget=200_000).match(replace(_truth(5).problem, deadline_s=0.0))
    assert not result.evidence.converged
    assert 0 < result.evidence.evaluated < 100_000
    assert result.matches


@pytest.mark.parametrize("name", _NAMES)
def test_degenerate_problems(name: str) -> None:
    problem = _truth(6, region_sd=None).problem
    flat = replace(problem.grid_map, mean=np.full_like(problem.grid_map.mean, 30.0))
    unmapped = replace(problem.grid_map, support=np.full(problem.grid_map.shape, 9.0, dtype=np.float32))
    track, profile = problem.track, problem.profile
    one = Track(track.t[:1], track.x[:1], track.y[:1], track.heading[:1], track.cov[:1])
    for changed in (
        replace(problem, grid_map=flat),
        replace(problem, grid_map=unmapped),
        MatchProblem(replace(profile, values=profile.values[:1]), one, problem.grid_map),
    ):
        assert _matcher(name, budget=600).match(changed).status is not Status.OK


@pytest.mark.parametrize("name", _NAMES)
def test_parameters_at_their_bounds_still_answer(name: str) -> None:
    """Budgets smaller than a population, and populations of the least size."""
    problem, entry = _truth(7).problem, MATCHERS[name]
    for end in ("low", "high"):
        whole = {
            key: type(getattr(entry.parameters(), key))(getattr(bound, end)) for key, bound in entry.bounds.items()
        }
        whole["budget"] = 300
        assert _matcher(name, **whole).match(problem).evidence.evaluated <= 300


def test_constriction() -> None:
    assert constriction(4.1) == pytest.approx(0.7298, abs=1e-4)  # Clerc and Kennedy 2002
    assert constriction(2.0) == 0.5
