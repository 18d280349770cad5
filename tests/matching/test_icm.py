"""ICM: contours bend a drifting track into place, and what they do not tell is not claimed."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest

from app.engine.matching import MATCHERS, Candidate, MatchProblem, MatchResult, Profile, Region, Track
from app.engine.matching.icm import Icm, IcmParameters
from app.engine.matching.placements import PlacementObjective
from app.engine.matching.starts import distinct, first_contour
from app.engine.types import FeatureSet, Status
from tests.support.drift import drifting_flight
from tests.support.fields import Truth, field_map, walk_through

_CHI2_95 = 5.991


def _mad_search(problem: MatchProblem) -> Candidate:
    """MAD of all shifts by whole cells in the region's box."""
    assert problem.region is not None
    cell = problem.grid_map.cell_m
    half = int(problem.region.half_widths()[0] // cell)
    steps = cell * np.arange(-half, half + 1)
    placements = np.zeros((len(steps) ** 2, 4))
    placements[:, 0], placements[:, 1] = np.repeat(steps, len(steps)), np.tile(steps, len(steps))
    placements[:, 3] = 1.0
    objective = PlacementObjective.of(problem)
    costs = objective.costs(placements)
    best = int(np.argmin(costs))
    return objective.candidate(placements[best], float(costs[best]))


def _mean_error(truth: Truth, x: np.ndarray, y: np.ndarray) -> float:
    return float(np.hypot(x - truth.x, y - truth.y).mean())


def test_drift_stops_adding_up() -> None:
    """Against a MAD search of the same region: a third of the error at most, an eighth of the placements."""
    inside = []
    for seed in range(8):
        truth = drifting_flight(seed, start_sd_m=4000.0)
        searched = _mad_search(truth.problem)
        result = Icm().match(truth.problem)
        match = result.matches[0]
        assert result.status is Status.OK
        assert _mean_error(truth, match.x, match.y) < _mean_error(truth, searched.x, searched.y) / 3.0
        assert truth.end_error(match.x, match.y) < truth.end_error(searched.x, searched.y) / 3.0
        away = np.array([match.x[-1] - truth.x[-1], match.y[-1] - truth.y[-1]])
        inside.append(away @ np.linalg.solve(match.cov, away) < _CHI2_95)
        assert result.evidence.evaluated < 121**2 / 8
    assert sum(inside) >= 6


@pytest.mark.parametrize("features", FeatureSet)
@pytest.mark.parametrize("region_sd", [5.0, None])
def test_turned_and_stretched_tracks_are_put_right(features: FeatureSet, region_sd: float | None) -> None:
    errors = []
    for seed in range(5):
        rng = np.random.default_rng(seed)
        truth = walk_through(
            field_map(rng, features=features),
            rng,
            start=(20.0, 20.0),
            shift=tuple(rng.normal(0.0, 4.0, 2)),
            rotation=0.12,
            scale=1.04,
            region_sd=region_sd,
        )
        match = Icm().match(truth.problem).matches[0]
        errors.append(_mean_error(truth, match.x, match.y))
    assert np.median(errors) < 0.1
    assert np.sum(np.array(errors) < 1.0) >= 4


def test_an_offset_of_the_sensor_is_found_on_the_way() -> None:
    errors = []
    for seed in range(5):
        rng = np.random.default_rng(seed)
        grid_map = field_map(rng, features=FeatureSet.HV)
        truth = walk_through(grid_map, rng, start=(20.0, 20.0), shift=(3.0, -2.0), offset_ut=8.0, offset_sd=10.0)
        match = Icm().match(truth.problem).matches[0]
        errors.append(_mean_error(truth, match.x, match.y))
    assert np.sum(np.array(errors) < 1.0) >= 4


def test_along_contours_nothing_is_claimed() -> None:
    rng = np.random.default_rng(3)
    grid_map = field_map(rng, features=FeatureSet.TOTAL)
    ridge = np.broadcast_to(grid_map.mean[:, :, :1], grid_map.mean.shape).copy()  # changes with y alone
    truth = walk_through(replace(grid_map, mean=ridge), rng, start=(20.0, 5.0), region_sd=30.0, turns=0.3)
    result = Icm().match(truth.problem)
    assert result.status in (Status.INSUFFICIENT, Status.AMBIGUOUS)
    cov = result.matches[0].cov
    assert np.sqrt(cov[0, 0]) > 10.0  # along
    assert np.sqrt(cov[1, 1]) < 3.0  # across


def test_a_translated_problem_has_a_translated_answer() -> None:
    truth = drifting_flight(2)
    here, there = Icm().match(truth.problem), Icm().match(_moved(truth.problem, 4000.0, -600.0))
    assert here.status is there.status
    for one, other in zip(here.matches, there.matches, strict=True):
        np.testing.assert_allclose(one.x + 4000.0, other.x, atol=1e-3)
        np.testing.assert_allclose(one.y - 600.0, other.y, atol=1e-3)
        np.testing.assert_allclose(one.cov, other.cov, rtol=1e-5)


def _moved(problem: MatchProblem, dx: float, dy: float) -> MatchProblem:
    assert problem.region is not None
    return replace(
        problem,
        track=replace(problem.track, x=problem.track.x + dx, y=problem.track.y + dy),
        grid_map=replace(problem.grid_map, x0=problem.grid_map.x0 + dx, y0=problem.grid_map.y0 + dy),
        region=replace(problem.region, x=problem.region.x + dx, y=problem.region.y + dy),
    )


def test_the_same_problem_has_the_same_answer_and_is_left_alone() -> None:
    problem = drifting_flight(1).problem
    before = pickle.dumps(problem)
    first, second = Icm().match(problem), pickle.loads(pickle.dumps(Icm())).match(problem)
    assert pickle.dumps(problem) == before
    for one, other in zip(first.matches, second.matches, strict=True):
        np.testing.assert_array_equal(one.x, other.x)
        assert one.weight == other.weight


def test_after_the_deadline_it_answers_with_what_it_has() -> None:
    result = Icm().match(replace(drifting_flight(1).problem, deadline_s=0.0))
    assert not result.evidence.converged
    assert result.matches


def test_degenerate_problems() -> None:
    truth = drifting_flight(4, start_sd_m=4000.0)
    problem = truth.problem
    flat = replace(problem.grid_map, mean=np.full_like(problem.grid_map.mean, float(problem.profile.values[0, 0])))
    _claims_nothing(Icm().match(replace(problem, grid_map=flat)))
    _claims_nothing(Icm().match(_first_points(problem, 1)))
    _claims_nothing(Icm().match(_first_points(problem, 2)))
    elsewhere = replace(problem, profile=replace(problem.profile, values=problem.profile.values + 30.0))
    result = Icm().match(elsewhere)
    _claims_nothing(result)
    assert "does not pass" in result.evidence.note


def _first_points(problem: MatchProblem, n: int) -> MatchProblem:
    track, profile = problem.track, problem.profile
    return replace(
        problem,
        track=Track(track.t[:n], track.x[:n], track.y[:n], track.heading[:n], track.cov[:n]),
        profile=Profile(profile.features, profile.values[:n], profile.noise_sd),
    )


def _claims_nothing(result: MatchResult) -> None:
    assert result.status in (Status.INSUFFICIENT, Status.AMBIGUOUS)
    assert all(np.all(np.isfinite(match.cov)) for match in result.matches)


def test_a_wider_contour_holds_the_narrower_one() -> None:
    problem = drifting_flight(5, noise_ut=5e-3).problem
    narrow, wide = first_contour(problem, 1.0), first_contour(problem, 4.0)
    assert 0 < len(narrow) < len(wide)
    assert {tuple(point) for point in narrow} <= {tuple(point) for point in wide}
    reach = np.array(problem.region.half_widths()) if isinstance(problem.region, Region) else np.zeros(2)
    assert np.all(np.abs(wide - problem.track.xy[0]) <= reach)


def test_distinct_placements_differ_at_one_end_at_least() -> None:
    rng = np.random.default_rng(6)
    placements = np.column_stack([rng.uniform(0, 5, (300, 2)), rng.uniform(-0.3, 0.3, 300), np.ones(300)])
    costs = rng.uniform(0.0, 1.0, 300)
    costs[:20] = np.inf
    xy = np.array([[0.0, 0.0], [10.0, 0.0]])
    kept = distinct(placements, costs, 2.0, 10, xy)
    assert kept[0] == int(np.argmin(costs))
    assert np.all(np.diff(costs[kept]) >= 0.0)
    c, s = 10.0 * np.cos(placements[:, 2]), 10.0 * np.sin(placements[:, 2])
    ends = placements[:, :2] + np.stack([c, s], axis=1)
    for i, a in enumerate(kept):
        for b in kept[:i]:
            starts, far = np.hypot(*(placements[a] - placements[b])[:2]), np.hypot(*(ends[a] - ends[b]))
            assert max(starts, far) > 2.0


def test_it_is_listed_with_bounds_that_hold_its_defaults() -> None:
    entry = MATCHERS["icm"]
    for name, bound in entry.bounds.items():
        assert bound.low <= getattr(IcmParameters(), name) <= bound.high
