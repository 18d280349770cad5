"""A compass that the map corrects finds its way, and says where it does not."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest

from app.engine.errors import InputError
from app.engine.matching import MATCHERS, MatchProblem, MatchResult
from app.engine.matching.declination import hausdorff
from app.engine.types import FeatureSet, Status
from tests.support.fields import Truth, field_map, walk_through

_CHI2_95 = 5.991


def matched(problem: MatchProblem, **parameters: object) -> MatchResult:
    entry = MATCHERS["declination_aided"]
    return entry.create(entry.parameters(**parameters)).match(problem)


def walk(seed: int, *, rotation: float = 0.0, drift: float = 0.0, region_sd: float = 1.5) -> Truth:
    """A walk whose track is turned as a whole and drifts by ``drift`` rad a reading besides."""
    rng = np.random.default_rng(seed)
    grid_map = field_map(rng, features=FeatureSet.VECTOR)
    shift = tuple(0.7 * region_sd * rng.standard_normal(2))
    truth = walk_through(
        grid_map, rng, start=(20.0, 20.0), noise_ut=0.6, region_sd=region_sd, turns=1.0, rotation=rotation,
        shift=(float(shift[0]), float(shift[1])),
    )  # fmt: skip
    problem = truth.problem
    assert problem.region is not None
    track, values = problem.track, problem.profile.values
    turn = np.exp(1j * drift * np.arange(len(track)))
    steps = (np.diff(track.x) + 1j * np.diff(track.y)) * turn[:-1]
    z = complex(track.x[0], track.y[0]) + np.concatenate([[0.0], np.cumsum(steps)])
    h = (values[:, 0] + 1j * values[:, 1]) * turn
    return replace(
        truth,
        problem=replace(
            problem,
            track=replace(track, x=z.real, y=z.imag, heading=track.heading + np.angle(turn)),
            profile=replace(problem.profile, values=np.stack([h.real, h.imag, values[:, 2]], axis=1)),
            region=replace(problem.region, heading_sd=1.5),
        ),
    )


def error(result: MatchResult, truth: Truth) -> float:
    return truth.end_error(result.matches[0].x, result.matches[0].y)


@pytest.mark.parametrize("rotation", [0.0, 1.1, -2.0])
def test_a_compass_needs_no_heading(rotation: float) -> None:
    truth = walk(1, rotation=rotation)
    result = matched(truth.problem)
    assert result.status is Status.OK
    assert error(result, truth) < 0.8
    assert result.matches[0].rotation == pytest.approx(rotation, abs=0.1)


def test_a_drifting_heading_is_held() -> None:
    errors = []
    for seed in range(5):
        truth = walk(seed, drift=0.01)
        assert truth.end_error(truth.problem.track.x, truth.problem.track.y) > 5.0
        errors.append(error(matched(truth.problem), truth))
    assert np.median(errors) < 0.8


def test_ellipses_hold_what_they_claim() -> None:
    inside, n = 0, 16
    for seed in range(n):
        truth = walk(20 + seed, rotation=0.4)
        match = matched(truth.problem).matches[0]
        away = np.array([match.x[-1] - truth.x[-1], match.y[-1] - truth.y[-1]])
        inside += float(away @ np.linalg.solve(match.cov, away)) <= _CHI2_95
    assert inside >= 0.85 * n


def test_a_constant_field_tells_nothing() -> None:
    truth = walk(2)
    grid_map = truth.problem.grid_map
    flat = replace(grid_map, mean=np.full_like(grid_map.mean, 25.0), cell_m=0.1)
    profile = replace(truth.problem.profile, values=np.full_like(truth.problem.profile.values, 25.0))
    result = matched(replace(truth.problem, grid_map=flat, profile=profile))
    assert result.status in (Status.INSUFFICIENT, Status.OFF_MAP)


def test_another_map_s_readings_are_not_accepted() -> None:
    truth, other = walk(3), walk(4)
    result = matched(replace(truth.problem, grid_map=other.problem.grid_map))
    assert "not accepted" in result.evidence.note


def test_moving_the_map_moves_the_answer() -> None:
    problem = walk(5).problem
    region, grid_map, track = problem.region, problem.grid_map, problem.track
    assert region is not None
    moved = replace(
        problem,
        grid_map=replace(grid_map, x0=grid_map.x0 + 300.0),
        region=replace(region, x=region.x + 300.0),
        track=replace(track, x=track.x + 300.0),
    )
    np.testing.assert_allclose(matched(moved).matches[0].x, matched(problem).matches[0].x + 300.0, atol=1e-6)


def test_the_same_problem_has_the_same_answer_and_is_left_as_it_was() -> None:
    problem = walk(6).problem
    before = pickle.dumps(problem)
    assert pickle.dumps(matched(problem)) == pickle.dumps(matched(problem))
    assert pickle.dumps(problem) == before


def test_what_is_missing_is_said() -> None:
    problem = walk(7).problem
    with pytest.raises(InputError, match="give a region"):
        matched(replace(problem, region=None))
    with pytest.raises(InputError, match="give the field's vector"):
        matched(replace(problem, grid_map=field_map(np.random.default_rng(7), features=FeatureSet.HV)))


@pytest.mark.parametrize("points", [1, 2, 3])
def test_short_tracks_end_in_an_answer(points: int) -> None:
    problem = walk(8).problem
    track, profile = problem.track, problem.profile
    cut = {name: getattr(track, name)[:points] for name in ("t", "x", "y", "heading", "cov")}
    short = replace(
        problem, track=replace(track, **cut), profile=replace(profile, values=profile.values[:points])
    )  # fmt: skip
    assert matched(short).evidence.evaluated == (0 if points < 3 else 6)


def test_a_deadline_leaves_one_beginning() -> None:
    result = matched(replace(walk(9).problem, deadline_s=0.0))
    assert result.evidence.evaluated == 1
    assert not result.evidence.converged


def test_hausdorff_is_that_of_the_definition() -> None:
    rng = np.random.default_rng(10)
    a, b = rng.standard_normal((7, 3)), rng.standard_normal((5, 3))
    forth = max(min(float(np.linalg.norm(p - q)) for q in b) for p in a)
    back = max(min(float(np.linalg.norm(p - q)) for p in a) for q in b)
    assert hausdorff(a, b) == pytest.approx(max(forth, back))
    assert hausdorff(a, a) == 0.0
