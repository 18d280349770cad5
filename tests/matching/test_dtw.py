"""Warping onto routes: places are found either way, at any speed, and none is claimed that the field does not tell."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest

from app.engine.errors import InputError
from app.engine.matching import MATCHERS, MatchProblem, MatchResult, Region
from app.engine.matching.dtw.search import Steps
from app.engine.matching.dtw.signals import Centre, Resample
from app.engine.types import FeatureSet, Float64Array, GridMap, Status
from tests.support.fields import Truth, field_map, walk_through, with_routes

WINDOWS = ("dtw", "improved_dtw", "sakoe_chiba_dtw", "ddtw", "ddtw_itakura")
ALL = (*WINDOWS, "subsequence_dtw", "voting_dtw")
_CHI2_95 = 5.991


def matched(name: str, problem: MatchProblem, **parameters: object) -> MatchResult:
    entry = MATCHERS[name]
    return entry.create(entry.parameters(**parameters)).match(problem)


def lines(y: tuple[float, ...] = (-15.0, 0.0, 40.0, 50.0)) -> tuple[Float64Array, ...]:
    """Straight lines that the walk is not on."""
    return tuple(np.stack([np.linspace(-5.0, 85.0, 50), np.full(50, one)], axis=1) for one in y)


def on_a_route(
    seed: int,
    *,
    features: FeatureSet = FeatureSet.HV,
    scale: float = 1.0,
    back: bool = False,
    rotation: float = 0.0,
    grid_map: GridMap | None = None,
    region_sd: float | None = None,
    turns: float = 0.6,
    noise_ut: float = 0.8,
    others: tuple[Float64Array, ...] | None = None,
) -> Truth:
    """A walk along the middle of a route, with a sensor that is 8 uT off; ``back`` against the route's direction."""
    rng = np.random.default_rng(seed)
    grid_map = field_map(rng, features=features) if grid_map is None else grid_map
    truth = walk_through(
        grid_map, rng, start=(20.0, 20.0), n=60, scale=scale, rotation=rotation, offset_ut=8.0, offset_sd=10.0,
        noise_ut=noise_ut, region_sd=region_sd, turns=turns,
    )  # fmt: skip
    way = np.stack([truth.x, truth.y], axis=1)
    before = way[0] + np.linspace(-15.0, -0.3, 30)[:, None] * (way[1] - way[0]) / np.hypot(*(way[1] - way[0]))
    after = way[-1] + np.linspace(0.3, 15.0, 30)[:, None] * (way[-1] - way[-2]) / np.hypot(*(way[-1] - way[-2]))
    line = np.concatenate([before, way, after])
    return with_routes(truth, (line[::-1] if back else line, *(lines() if others is None else others)))


def error(result: MatchResult, truth: Truth) -> float:
    return truth.end_error(result.matches[0].x, result.matches[0].y)


@pytest.mark.parametrize("back", [False, True])
@pytest.mark.parametrize("features", FeatureSet)
@pytest.mark.parametrize("scale", [0.87, 1.0, 1.15])
def test_open_ends_find_the_place_at_any_speed(features: FeatureSet, scale: float, back: bool) -> None:
    truth = on_a_route(11, features=features, scale=scale, back=back)
    result = matched("subsequence_dtw", truth.problem)
    assert error(result, truth) < 1.2
    assert result.matches[0].scale == pytest.approx(scale, abs=0.05)
    assert result.status is Status.OK
    away = np.hypot(result.matches[0].x - truth.x, result.matches[0].y - truth.y)
    assert np.sqrt((away**2).mean()) < 1.0


@pytest.mark.parametrize("back", [False, True])
@pytest.mark.parametrize("name", WINDOWS)
def test_windows_find_the_place(name: str, back: bool) -> None:
    for scale, allowed in ((1.0, 1.5), (0.9, 4.0), (1.1, 4.0)):
        truth = on_a_route(12, scale=scale, back=back)
        result = matched(name, truth.problem)
        assert result.status is Status.OK
        assert error(result, truth) < allowed


@pytest.mark.parametrize("centre", [Centre.MEAN, Centre.DIFFERENCE])
@pytest.mark.parametrize("name", ["dtw", "subsequence_dtw"])
def test_centring_makes_an_offset_harmless(name: str, centre: Centre) -> None:
    truth = on_a_route(13, features=FeatureSet.TOTAL, noise_ut=0.2)
    found = matched(name, truth.problem, centre=centre).matches[0]
    profile = replace(truth.problem.profile, values=truth.problem.profile.values + 20.0)
    moved = matched(name, replace(truth.problem, profile=profile), centre=centre).matches[0]
    np.testing.assert_allclose(moved.x, found.x, atol=0.3)  # of paths that cost the same, rounding picks one
    assert truth.end_error(found.x, found.y) < 1.5


def test_without_centring_an_offset_is_part_of_the_cost() -> None:
    truth = on_a_route(13, features=FeatureSet.TOTAL)
    cost = {c: matched("subsequence_dtw", truth.problem, centre=c).matches[0].cost for c in (Centre.NONE, Centre.MEAN)}
    assert cost[Centre.NONE] > 2.0 * cost[Centre.MEAN]


@pytest.mark.parametrize("name", ["subsequence_dtw", "improved_dtw", "voting_dtw"])
def test_vectors_need_no_compass(name: str) -> None:
    """A track that is turned as a whole lands in the same place, and tells by how much it was turned."""
    angles = (0.0, 1.0, -2.5)
    truths = [on_a_route(14, features=FeatureSet.VECTOR, rotation=angle, turns=0.0) for angle in angles]
    parameters = {"speed_mps": 0.8} if name == "voting_dtw" else {}
    for truth, angle in zip(truths, angles, strict=True):
        result = matched(name, truth.problem, **parameters)
        assert error(result, truth) < 1.5
        assert result.matches[0].rotation == pytest.approx(angle, abs=0.05)


@pytest.mark.parametrize("name", ALL)
def test_two_equal_corridors_are_told_as_two(name: str) -> None:
    rng = np.random.default_rng(15)
    grid_map = field_map(rng, features=FeatureSet.VECTOR)
    mean = grid_map.mean.copy()
    mean[:, 80:] = mean[:, :80]  # rows 40 m apart are alike
    twin = replace(grid_map, mean=mean)
    truth = on_a_route(16, features=FeatureSet.VECTOR, grid_map=twin, turns=0.0, others=())
    way = np.stack([np.linspace(0.0, 80.0, 200), np.full(200, 20.0)], axis=1)
    truth = with_routes(truth, (way, way - [0.0, 40.0]))
    result = matched(name, truth.problem, **({"speed_mps": 0.7} if name == "voting_dtw" else {}))
    assert result.status is Status.AMBIGUOUS
    ends = sorted(float(match.y[-1]) for match in result.matches[:2])
    assert ends == pytest.approx([-20.0, 20.0], abs=0.5)
    assert min(match.weight for match in result.matches[:2]) > 0.1


@pytest.mark.parametrize("name", ALL)
def test_a_constant_field_tells_nothing(name: str) -> None:
    rng = np.random.default_rng(17)
    grid_map = field_map(rng, features=FeatureSet.VECTOR)
    flat = replace(grid_map, mean=np.full_like(grid_map.mean, 25.0))
    truth = on_a_route(18, features=FeatureSet.VECTOR, grid_map=flat, turns=0.0)
    assert matched(name, truth.problem).status is Status.INSUFFICIENT


@pytest.mark.parametrize("name", ALL)
def test_moving_the_map_moves_the_answer(name: str) -> None:
    truth = on_a_route(19, features=FeatureSet.VECTOR, turns=0.0, region_sd=20.0)
    problem = truth.problem
    region = problem.region
    assert region is not None
    moved = replace(
        problem,
        grid_map=replace(problem.grid_map, x0=problem.grid_map.x0 + 300.0, y0=problem.grid_map.y0 - 70.0),
        region=replace(region, x=region.x + 300.0, y=region.y - 70.0),
        track=replace(problem.track, x=problem.track.x + 300.0, y=problem.track.y - 70.0),
        routes=tuple(replace(route, x=route.x + 300.0, y=route.y - 70.0) for route in problem.routes),
    )
    parameters = {"speed_mps": 0.8} if name == "voting_dtw" else {}
    here, there = matched(name, problem, **parameters), matched(name, moved, **parameters)
    assert here.status is there.status
    np.testing.assert_allclose(there.matches[0].x, here.matches[0].x + 300.0, atol=1e-6)
    np.testing.assert_allclose(there.matches[0].cov, here.matches[0].cov, rtol=1e-6)


def test_a_region_decides_between_equal_places() -> None:
    rng = np.random.default_rng(15)
    grid_map = field_map(rng, features=FeatureSet.HV)
    mean = grid_map.mean.copy()
    mean[:, 80:] = mean[:, :80]
    truth = on_a_route(16, grid_map=replace(grid_map, mean=mean), turns=0.0, others=())
    way = np.stack([np.linspace(0.0, 80.0, 200), np.full(200, 20.0)], axis=1)
    truth = with_routes(truth, (way, way - [0.0, 40.0]))
    for y in (20.0, -20.0):
        region = Region(20.0, y, np.eye(2) * 4.0)
        for name in ("subsequence_dtw", "sakoe_chiba_dtw"):
            result = matched(name, replace(truth.problem, region=region))
            assert result.status is Status.OK
            assert result.matches[0].y[0] == pytest.approx(y, abs=0.5)
            assert abs(result.matches[0].x[0] - 20.0) < 9.0


def test_ellipses_hold_what_they_claim() -> None:
    inside, n = 0, 24
    for seed in range(n):
        scale = float(np.random.default_rng(seed).uniform(0.87, 1.15))
        truth = on_a_route(100 + seed, scale=scale, back=bool(seed % 2), noise_ut=1.5)
        match = matched("subsequence_dtw", truth.problem).matches[0]
        away = np.array([match.x[-1] - truth.x[-1], match.y[-1] - truth.y[-1]])
        inside += float(away @ np.linalg.solve(match.cov, away)) <= _CHI2_95
    assert inside >= 0.87 * n


def test_time_serves_where_speed_is_even() -> None:
    truth = on_a_route(20)
    result = matched("subsequence_dtw", truth.problem, resample=Resample.TIME, steps=Steps.CLASSIC)
    assert error(result, truth) < 1.2


@pytest.mark.parametrize("name", ALL)
def test_the_same_problem_has_the_same_answer_and_is_left_as_it_was(name: str) -> None:
    truth = on_a_route(21, features=FeatureSet.VECTOR)
    before = pickle.dumps(truth.problem)
    entry = MATCHERS[name]
    matcher = entry.create(entry.parameters())
    first, second = matcher.match(truth.problem), pickle.loads(pickle.dumps(matcher)).match(truth.problem)
    assert pickle.dumps(truth.problem) == before
    assert pickle.dumps(first) == pickle.dumps(second)


@pytest.mark.parametrize("name", ALL)
def test_what_is_missing_is_said(name: str) -> None:
    truth = on_a_route(22, features=FeatureSet.VECTOR)
    with pytest.raises(InputError, match="give routes"):
        matched(name, replace(truth.problem, routes=()))
    if name == "voting_dtw":
        total = on_a_route(22, features=FeatureSet.TOTAL)
        with pytest.raises(InputError, match="three axes"):
            matched(name, total.problem)


@pytest.mark.parametrize("name", ALL)
@pytest.mark.parametrize("points", [1, 2, 3])
def test_short_tracks_are_told_to_walk_on(name: str, points: int) -> None:
    problem = on_a_route(23, features=FeatureSet.VECTOR).problem
    track, profile = problem.track, problem.profile
    short = replace(
        problem,
        track=replace(
            track, t=track.t[:points], x=0.1 * track.x[:points], y=0.1 * track.y[:points],
            heading=track.heading[:points], cov=track.cov[:points],
        ),
        profile=replace(profile, values=profile.values[:points]),
    )  # fmt: skip
    result = matched(name, short)
    assert result.status is Status.INSUFFICIENT
    assert result.walk_on_m


def test_routes_shorter_than_the_track_hold_no_window() -> None:
    truth = on_a_route(24)
    short = with_routes(truth, (np.array([[0.0, 0.0], [9.0, 0.0]]),))
    for name in WINDOWS:
        result = matched(name, short.problem)
        assert result.status is Status.INSUFFICIENT
        assert "no route" in result.evidence.note


@pytest.mark.parametrize("name", ALL)
def test_a_deadline_is_kept(name: str) -> None:
    truth = on_a_route(25, features=FeatureSet.VECTOR)
    result = matched(name, replace(truth.problem, deadline_s=0.0))
    assert not result.evidence.converged
    assert result.evidence.evaluated == 0
    assert result.status is Status.INSUFFICIENT
