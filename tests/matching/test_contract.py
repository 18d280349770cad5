"""What every matcher keeps to, over the registry."""

from __future__ import annotations

import dataclasses
import pickle
import re
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from app.engine.errors import InputError
from app.engine.matching import MATCHERS, MatcherEntry, MatchProblem, MatchResult, Profile, Track, common_features
from app.engine.types import FeatureSet, Status
from tests.support.fields import Truth, field_map, walk_through, with_routes


@pytest.fixture(params=sorted(MATCHERS))
def entry(request: pytest.FixtureRequest) -> MatcherEntry:
    return MATCHERS[request.param]


def problem_for(entry: MatcherEntry, *, seed: int = 0, n: int = 50, features: FeatureSet | None = None) -> Truth:
    """A walk along a line that the map has kept, with a start known to some metres."""
    rng = np.random.default_rng(seed)
    grid_map = field_map(rng, features=features or entry.features[0], shape=(120, 160))
    truth = walk_through(grid_map, rng, start=(5.0, 5.0), n=n, shift=(1.0, -0.5), region_sd=2.0)
    way = np.stack([truth.x, truth.y], axis=1)
    before, after = way[0] - np.outer(np.arange(8.0, 0.0, -0.5), way[1] - way[0]), 2.0 * way[-1] - way[-13:-1][::-1]
    return with_routes(truth, (np.concatenate([before, way, after]), np.array([[0.0, -10.0], [50.0, -10.0]])))


def run(entry: MatcherEntry, problem: MatchProblem) -> MatchResult:
    return entry.create(entry.parameters()).match(problem)


def same(one: MatchResult, other: MatchResult) -> bool:
    return (
        one.status is other.status
        and len(one.matches) == len(other.matches)
        and all(
            np.array_equal(a.x, b.x)
            and np.array_equal(a.y, b.y)
            and np.array_equal(a.cov, b.cov)
            and a.weight == b.weight
            for a, b in zip(one.matches, other.matches, strict=True)
        )
    )


def test_the_same_problem_has_the_same_answer(entry: MatcherEntry) -> None:
    problem = problem_for(entry).problem
    assert same(run(entry, problem), run(entry, problem))


def test_the_answer_is_whole(entry: MatcherEntry) -> None:
    """Placements as long as the track, finite, with covariances that are covariances and weights that are shares."""
    truth = problem_for(entry)
    result = run(entry, truth.problem)
    assert result.evidence.evaluated > 0
    assert sum(match.weight for match in result.matches) <= 1.0 + 1e-9
    for match in result.matches:
        assert match.x.shape == match.y.shape == truth.x.shape
        assert np.isfinite([match.x, match.y]).all()
        assert np.isfinite(match.cov).all()
        np.testing.assert_allclose(match.cov, match.cov.T, atol=1e-9 * np.abs(match.cov).max())
        assert np.linalg.eigvalsh(match.cov)[0] >= 0.0
        assert 0.0 <= match.weight <= 1.0


def test_a_place_it_claims_is_the_right_one(entry: MatcherEntry) -> None:
    """Over several fields: claimed places are right, and most fields give one."""
    claimed, right = 0, 0
    for seed in range(5):
        truth = problem_for(entry, seed=seed)
        result = run(entry, truth.problem)
        if result.status is Status.OK:
            claimed += 1
            right += truth.end_error(result.matches[0].x, result.matches[0].y) < 3.0
    assert right == claimed
    assert claimed >= 2


def test_input_is_not_changed(entry: MatcherEntry) -> None:
    problem = problem_for(entry).problem
    before = pickle.dumps([problem.profile.values, problem.track.x, problem.track.y, problem.grid_map.mean])
    run(entry, problem)
    assert pickle.dumps([problem.profile.values, problem.track.x, problem.track.y, problem.grid_map.mean]) == before


def test_it_pickles(entry: MatcherEntry) -> None:
    matcher = pickle.loads(pickle.dumps(entry.create(entry.parameters())))
    problem = problem_for(entry).problem
    assert same(matcher.match(problem), run(entry, problem))


@pytest.mark.parametrize("n", [1, 2, 3])
def test_a_track_of_a_few_points_is_taken(entry: MatcherEntry, n: int) -> None:
    """Nothing is claimed of it that a few readings cannot carry, and nothing breaks."""
    problem = problem_for(entry).problem
    track = Track(*(getattr(problem.track, f.name)[:n] for f in dataclasses.fields(Track)))
    result = run(
        entry, replace(problem, track=track, profile=replace(problem.profile, values=problem.profile.values[:n]))
    )
    assert isinstance(result.status, Status)


def test_a_constant_field_gives_no_place(entry: MatcherEntry) -> None:
    problem = problem_for(entry).problem
    flat = np.broadcast_to(problem.grid_map.mean.mean(axis=(1, 2))[:, None, None], problem.grid_map.mean.shape)
    grid_map = replace(problem.grid_map, mean=np.ascontiguousarray(flat, dtype=np.float32))
    values = np.tile(flat[:, 0, 0].astype(np.float64), (len(problem), 1))
    routes = tuple(replace(route, mean=np.tile(values[0], (len(route), 1))) for route in problem.routes)
    wide = replace(problem.region, cov=np.eye(2) * 400.0)  # type: ignore[type-var]
    result = run(
        entry,
        replace(
            problem, grid_map=grid_map, profile=replace(problem.profile, values=values), routes=routes, region=wide
        ),
    )
    assert result.status is not Status.OK


@pytest.mark.parametrize("features", FeatureSet)
def test_features_are_taken_as_promised(entry: MatcherEntry, features: FeatureSet) -> None:
    problem = problem_for(entry, features=features).problem
    if features in entry.features:
        assert run(entry, problem).evidence.evaluated > 0
    else:
        with pytest.raises(InputError) as caught:
            run(entry, problem)
        assert caught.value.field == "features"


def test_readings_may_hold_more_than_the_map(entry: MatcherEntry) -> None:
    """A vector magnetometer on a map of the total field."""
    if FeatureSet.TOTAL not in entry.features:
        pytest.skip("needs more than the total field")
    truth = problem_for(entry, features=FeatureSet.TOTAL)
    total = truth.problem.profile.values[:, 0]
    vector = Profile(FeatureSet.VECTOR, np.stack([0.6 * total, 0.0 * total, -0.8 * total], axis=1), np.full(3, 0.2))
    assert common_features(FeatureSet.VECTOR, FeatureSet.TOTAL) is FeatureSet.TOTAL
    assert run(entry, replace(truth.problem, profile=vector)).evidence.evaluated > 0


def test_what_is_missing_is_named(entry: MatcherEntry) -> None:
    problem = problem_for(entry).problem
    bare = replace(problem, region=None, routes=())
    missing = [name for name, needed in (("region", entry.needs_region), ("routes", entry.needs_routes)) if needed]
    if not missing:
        assert run(entry, replace(bare, deadline_s=5.0)).evidence.evaluated > 0
        return
    with pytest.raises(InputError) as caught:
        run(entry, bare)
    assert caught.value.field in missing


@pytest.mark.timing
def test_a_deadline_is_kept(entry: MatcherEntry) -> None:
    problem = problem_for(entry).problem
    wide = replace(problem, region=replace(problem.region, cov=np.eye(2) * 100.0))  # type: ignore[type-var]
    run(entry, wide)  # kernels are compiled
    started = time.thread_time()
    run(entry, replace(wide, deadline_s=0.02))
    assert time.thread_time() - started < 2.0


def test_parameters_are_described_and_bounded(entry: MatcherEntry) -> None:
    for item in dataclasses.fields(entry.parameters):
        assert re.search(rf"^    {item.name} : ", entry.parameters.__doc__ or "", re.MULTILINE), item.name
        if isinstance(item.default, int | float) and not isinstance(item.default, bool):
            bound = entry.bounds[item.name]
            assert bound.low <= item.default <= bound.high


def test_the_page_of_methods_lists_it(entry: MatcherEntry) -> None:
    assert f"| `{entry.name}` |" in Path("docs/methods.md").read_text()
