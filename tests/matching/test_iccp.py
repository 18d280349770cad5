"""Closest contour searches: the track comes to rest where all of its readings lie on their contours."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from app.engine.errors import InputError
from app.engine.matching import MATCHERS, Matcher, MatchProblem, Track
from app.engine.matching.contours import ContourMap
from app.engine.matching.correspondence import associated_contours, nearest_contours, nearest_vectors
from app.engine.matching.iccp import IccpParameters, fit_similarity
from app.engine.types import FeatureSet, Status
from tests.support.fields import Truth, field_map, walk_through

_NAMES = ("iccp", "iccp_affine", "iccp_vector", "iccp_pda")


def _matcher(name: str, **changed: object) -> Matcher:
    return MATCHERS[name].create(replace(IccpParameters(), **changed))  # type: ignore[arg-type]


def _truth(seed: int, features: FeatureSet = FeatureSet.HV, **how: object) -> Truth:
    rng = np.random.default_rng(seed)
    how = {"start": (20.0, 20.0), "shift": tuple(rng.normal(0.0, 4.0, 2)), "n": 40, **how}
    return walk_through(field_map(rng, features=features), rng, **how)  # type: ignore[arg-type]


def _error(truth: Truth, x: np.ndarray, y: np.ndarray) -> float:
    return float(np.hypot(x - truth.x, y - truth.y).mean())


@pytest.mark.parametrize("name", _NAMES)
@pytest.mark.parametrize("features", FeatureSet)
def test_shift_and_turn_are_found(name: str, features: FeatureSet) -> None:
    if features not in MATCHERS[name].features:
        with pytest.raises(InputError, match="single one"):
            _matcher(name).match(_truth(0, features).problem)
        return
    for seed in range(2):
        truth = _truth(seed, features, rotation=0.12)
        result = _matcher(name).match(truth.problem)
        match = result.matches[0]
        assert result.status is Status.OK
        assert _error(truth, match.x, match.y) < 0.25
        assert match.rotation == pytest.approx(0.12, abs=0.02)


def test_only_the_affine_search_finds_a_scale() -> None:
    truth = _truth(1, scale=1.08)
    rigid, affine = (_matcher(name).match(truth.problem).matches[0] for name in ("iccp", "iccp_affine"))
    assert rigid.scale == 1.0
    assert affine.scale == pytest.approx(1.08, abs=0.01)
    assert _error(truth, affine.x, affine.y) < 0.3 * _error(truth, rigid.x, rigid.y)


def test_pseudo_measurements_bear_more_noise() -> None:
    plain, fused = [], []
    for seed in range(4):
        truth = _truth(seed, FeatureSet.TOTAL, noise_ut=1.5)
        plain.append(_error(truth, *_end(_matcher("iccp"), truth)))
        fused.append(_error(truth, *_end(_matcher("iccp_pda"), truth)))
    assert np.mean(fused) < 1.1 * np.mean(plain)


def _end(matcher: Matcher, truth: Truth) -> tuple[np.ndarray, np.ndarray]:
    match = matcher.match(truth.problem).matches[0]
    return match.x, match.y


def test_without_a_coarse_search_it_rests_nearby() -> None:
    """From a cell beside the truth it falls into it; from far away it comes to rest elsewhere."""
    near, far = _truth(2, shift=(0.4, -0.3)), _truth(2, shift=(9.0, -7.0))
    match = _matcher("iccp", coarse=False).match(near.problem).matches[0]
    assert _error(near, match.x, match.y) < 0.1
    result = _matcher("iccp", coarse=False).match(far.problem)
    assert _error(far, result.matches[0].x, result.matches[0].y) > 2.0
    again = _matcher("iccp").match(far.problem).matches[0]
    assert _error(far, again.x, again.y) < 0.1


def test_the_evidence_tells_of_the_rest() -> None:
    truth = _truth(3)
    evidence = _matcher("iccp").match(truth.problem).evidence
    assert evidence.converged
    assert 1 <= evidence.iterations <= 100
    assert "of 4 starts 2 cells beside it fall into that place" in evidence.note
    assert not _matcher("iccp", max_iterations=1).match(truth.problem).evidence.converged


@pytest.mark.parametrize("name", _NAMES)
def test_a_translated_problem_has_a_translated_answer(name: str) -> None:
    problem = _truth(4).problem
    assert problem.region is not None
    moved = replace(
        problem,
        track=replace(problem.track, x=problem.track.x + 100.0, y=problem.track.y - 50.0),
        grid_map=replace(problem.grid_map, x0=problem.grid_map.x0 + 100.0, y0=problem.grid_map.y0 - 50.0),
        region=replace(problem.region, x=problem.region.x + 100.0, y=problem.region.y - 50.0),
    )
    here, there = _matcher(name).match(problem).matches[0], _matcher(name).match(moved).matches[0]
    np.testing.assert_allclose(here.x + 100.0, there.x, atol=5e-3)
    np.testing.assert_allclose(here.y - 50.0, there.y, atol=5e-3)


@pytest.mark.parametrize("name", _NAMES)
def test_degenerate_problems(name: str) -> None:
    truth = _truth(5, region_sd=None)
    problem = truth.problem
    flat = replace(problem.grid_map, mean=np.full_like(problem.grid_map.mean, 30.0))
    unmapped = replace(problem.grid_map, support=np.full(problem.grid_map.shape, 9.0, dtype=np.float32))
    track, profile = problem.track, problem.profile
    one = Track(track.t[:1], track.x[:1], track.y[:1], track.heading[:1], track.cov[:1])
    for changed in (
        replace(problem, grid_map=flat),
        replace(problem, grid_map=unmapped),
        MatchProblem(replace(profile, values=profile.values[:1]), one, problem.grid_map),
    ):
        assert _matcher(name).match(changed).status is not Status.OK


@pytest.mark.parametrize("name", _NAMES)
def test_deterministic_pickled_and_in_time(name: str) -> None:
    problem = _truth(6).problem
    before = pickle.dumps(problem)
    first = _matcher(name).match(problem)
    second = pickle.loads(pickle.dumps(_matcher(name))).match(problem)
    np.testing.assert_array_equal(first.matches[0].x, second.matches[0].x)
    assert pickle.dumps(problem) == before
    late = _matcher(name).match(replace(problem, deadline_s=0.0))
    assert not late.evidence.converged
    assert late.matches


@settings(max_examples=60, deadline=None)
@given(st.floats(-3.0, 3.0), st.floats(0.5, 2.0), st.floats(-100.0, 100.0), st.integers(0, 1000), st.booleans())
def test_the_closed_form_fit_is_the_least_squares_fit(
    turn: float, stretch: float, shift: float, seed: int, scaled: bool
) -> None:
    rng = np.random.default_rng(seed)
    points, weights = rng.normal(0.0, 5.0, (6, 2)), rng.uniform(0.1, 1.0, 6)
    stretch = stretch if scaled else 1.0
    c, s = stretch * np.cos(turn), stretch * np.sin(turn)
    targets = points @ np.array([[c, s], [-s, c]]) + (shift, -shift)
    found = fit_similarity(points, targets, weights, scaled=scaled)
    assert found[0] == pytest.approx(turn, abs=1e-6)
    assert found[1] == pytest.approx(stretch, abs=1e-6)
    noisy = targets + 0.3 * rng.standard_normal(targets.shape)
    best = fit_similarity(points, noisy, weights, scaled=scaled)
    for step in (1e-3, -1e-3):
        assert _loss(points, noisy, weights, *best) <= _loss(points, noisy, weights, best[0] + step, best[1], best[2])
        assert _loss(points, noisy, weights, *best) <= _loss(points, noisy, weights, best[0], best[1], best[2] + step)
        if scaled:
            assert _loss(points, noisy, weights, *best) <= _loss(
                points, noisy, weights, best[0], best[1] + step, best[2]
            )


def _loss(points, targets, weights, turn, stretch, shift):  # type: ignore[no-untyped-def]
    centre = np.average(points, axis=0, weights=weights)
    c, s = stretch * np.cos(turn), stretch * np.sin(turn)
    moved = (points - centre) @ np.array([[c, s], [-s, c]]) + centre + shift
    return float((weights[:, None] * (targets - moved) ** 2).sum()) - 1e-9


def test_what_points_are_drawn_to() -> None:
    """A point that is right stays, one beside the truth is drawn towards it, and none to beyond its radius."""
    truth = _truth(7, noise_ut=0.0)
    contours = ContourMap.of(truth.problem.grid_map, FeatureSet.HV)
    right = np.stack([truth.x, truth.y], axis=1)
    values, sd = truth.problem.profile.values, np.full(truth.problem.profile.values.shape, 0.3)
    for pull_of in (nearest_contours, associated_contours, nearest_vectors):
        stays = pull_of(contours, right, values, sd, 4.0)
        assert np.abs(stays.targets - right[:, None]).max() < 0.35
        beside = pull_of(contours, right + 0.3, values, sd, 4.0)
        before, after = np.hypot(0.3, 0.3), np.hypot(*(beside.targets - right[:, None]).reshape(-1, 2).T)
        assert np.median(after) < before
        wrong = pull_of(contours, right, values + 500.0, sd, 4.0)
        assert wrong.weights.max() < 1e-3
    vectors = nearest_vectors(contours, right + 0.3, values, sd, 4.0).targets[:, 0]
    assert np.median(np.hypot(*(vectors - right).T)) < 0.1
