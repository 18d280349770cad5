"""MAGCOM finds what was shifted, turned and stretched, and claims no more than the field tells."""

from __future__ import annotations

import pickle
import time
from dataclasses import replace

import numpy as np
import pytest

from app.engine.errors import InputError
from app.engine.matching import MATCHERS, MatchProblem, MatchResult, Region, contour_search, read_map
from app.engine.matching.criteria import Criterion
from app.engine.matching.magcom import Magcom, MagcomParameters
from app.engine.matching.placements import PlacementObjective, placed
from app.engine.types import FeatureSet, Status
from tests.support.fields import Truth, field_map, walk_through

FINDS_ALONE = [c for c in Criterion if c not in (Criterion.COR, Criterion.PROD)]


def match(problem: MatchProblem, **parameters: object) -> MatchResult:
    return Magcom(MagcomParameters(**parameters)).match(problem)  # type: ignore[arg-type]


def end_error(truth: Truth, result: MatchResult) -> float:
    return truth.end_error(result.matches[0].x, result.matches[0].y)


def a_walk(seed: int, features: FeatureSet = FeatureSet.VECTOR, **walk: object) -> Truth:
    rng = np.random.default_rng(seed)
    where = {"start": (20.0, 20.0), **walk}
    return walk_through(field_map(rng, features=features), rng, **where)  # type: ignore[arg-type]


@pytest.mark.parametrize("criterion", FINDS_ALONE)
@pytest.mark.parametrize("features", FeatureSet)
def test_a_shift_is_found_by_each_criterion(criterion: Criterion, features: FeatureSet) -> None:
    if criterion is Criterion.HAUSDORFF and features is FeatureSet.TOTAL:
        pytest.skip("which values of one channel occur says little of the place")
    truth = a_walk(1, features, shift=(4.3, -3.1))
    result = match(truth.problem, criterion=criterion)
    assert result.status is Status.OK
    assert end_error(truth, result) < 0.2
    assert result.matches[0].rotation == 0.0
    assert result.matches[0].scale == 1.0


@pytest.mark.parametrize("criterion", [Criterion.COR, Criterion.PROD])
@pytest.mark.parametrize("seed", range(3))
def test_products_claim_nothing_where_they_are_drawn_to_strong_fields(criterion: Criterion, seed: int) -> None:
    truth = a_walk(seed, shift=(4.3, -3.1))
    result = match(truth.problem, criterion=criterion)
    assert result.status is not Status.OK or end_error(truth, result) < 0.2


@pytest.mark.parametrize("features", FeatureSet)
@pytest.mark.parametrize(("rotations", "scales"), [(21, 5), (0, 0)])
def test_rotation_and_scale_are_found(features: FeatureSet, rotations: int, scales: int) -> None:
    truth = a_walk(2, features, shift=(3.0, 2.0), rotation=0.17, scale=1.12)
    result = match(truth.problem, rotations=rotations, scales=scales)
    assert result.status is Status.OK
    assert end_error(truth, result) < 0.2
    assert result.matches[0].rotation == pytest.approx(0.17, abs=0.01)
    assert result.matches[0].scale == pytest.approx(1.12, abs=0.01)


def test_products_find_places_in_anomalies() -> None:
    """Of a field that varies about zero; the strongest place nearby does not draw the answer from the right one."""
    rng = np.random.default_rng(17)
    grid_map = field_map(rng)
    anomaly = replace(grid_map, mean=grid_map.mean - grid_map.mean.mean(axis=(1, 2), keepdims=True))
    truth = walk_through(anomaly, rng, start=(20.0, 20.0), n=100, shift=(4.3, -3.1))
    assert end_error(truth, match(truth.problem, criterion=Criterion.COR)) < 0.05


@pytest.mark.parametrize("criterion", [Criterion.CC, Criterion.NPROD])
def test_vectors_turn_with_the_track_by_any_criterion(criterion: Criterion) -> None:
    truth = a_walk(18, shift=(2.0, 2.0), rotation=-0.4)
    region = replace(truth.problem.region, heading_sd=0.2)  # type: ignore[type-var]
    result = match(replace(truth.problem, region=region), criterion=criterion, rotations=0)
    assert end_error(truth, result) < 0.2
    assert result.matches[0].rotation == pytest.approx(-0.4, abs=0.01)


def test_a_track_may_be_turned_back_onto_the_map() -> None:
    """Near the map's right edge, going up; indicated to the right, off the map."""
    truth = a_walk(19, start=(84.0, 0.0), n=50, turns=0.3)
    way, heading = truth.problem.track, 0.5 * np.pi
    x, y = 84.0 - (way.y - way.y[0]), way.x - way.x[0]  # the same walk turned by a right angle
    values = read_map(truth.problem.grid_map, FeatureSet.VECTOR, x, y).mean
    profile = replace(truth.problem.profile, values=values).turned(-heading)
    region = Region(84.0, 0.0, 9.0 * np.eye(2), heading_sd=0.6, scale_sd=0.01)
    problem = replace(truth.problem, profile=profile, region=region)
    found = match(problem, rotations=0).matches[0]
    assert np.hypot(found.x[-1] - x[-1], found.y[-1] - y[-1]) < 0.2
    assert found.rotation == pytest.approx(heading, abs=0.02)


def test_without_a_region_the_whole_map_is_searched() -> None:
    truth = a_walk(3, region_sd=None)
    away = replace(truth.problem.track, x=truth.problem.track.x + 300.0, y=truth.problem.track.y - 90.0)
    result = match(replace(truth.problem, track=away))
    assert result.status is Status.OK
    assert end_error(truth, result) < 0.1
    assert result.evidence.evaluated > 3_000


def test_an_offset_is_forgiven_if_it_is_known_to_be_there() -> None:
    truth = a_walk(4, FeatureSet.HV, shift=(4.0, 4.0), offset_ut=9.0, offset_sd=9.0)
    assert end_error(truth, match(truth.problem)) < 0.2
    assert end_error(truth, match(truth.problem, criterion=Criterion.CC, centre=False)) < 0.2
    assert match(truth.problem, centre=False).matches[0].cost > 5.0


def test_features_are_reduced_to_what_is_wanted_and_there() -> None:
    rng = np.random.default_rng(5)
    total = field_map(rng, features=FeatureSet.TOTAL)
    truth = walk_through(field_map(rng), rng, start=(20.0, 20.0), shift=(3.0, 1.0))
    assert end_error(truth, match(truth.problem, features=FeatureSet.TOTAL)) < 0.3
    assert match(replace(truth.problem, grid_map=total)).status is not Status.OK
    fewer = replace(truth.problem, profile=truth.problem.profile.as_features(FeatureSet.HV))  # on a map of vectors
    assert end_error(truth, match(fewer)) < 0.2


@pytest.mark.parametrize(("dx", "dy"), [(100.0, -40.0), (3.7, 8.2)])
def test_a_map_that_is_moved_moves_the_answer(dx: float, dy: float) -> None:
    problem = a_walk(6, shift=(3.0, -2.0), rotation=0.05).problem
    moved = replace(
        problem,
        grid_map=replace(problem.grid_map, x0=problem.grid_map.x0 + dx, y0=problem.grid_map.y0 + dy),
        track=replace(problem.track, x=problem.track.x + dx, y=problem.track.y + dy),
        region=replace(problem.region, x=problem.region.x + dx, y=problem.region.y + dy),  # type: ignore[type-var,union-attr]
    )
    before, after = match(problem, rotations=7), match(moved, rotations=7)
    np.testing.assert_allclose(after.matches[0].x - dx, before.matches[0].x, atol=1e-3)
    np.testing.assert_allclose(after.matches[0].y - dy, before.matches[0].y, atol=1e-3)


def test_a_place_repeated_on_the_map_is_ambiguous() -> None:
    rng = np.random.default_rng(7)
    grid_map = field_map(rng)
    mean = grid_map.mean.copy()
    mean[:, :, 100:] = mean[:, :, :100]
    truth = walk_through(replace(grid_map, mean=mean), rng, start=(0.0, 10.0), n=40, region_sd=None)
    result = match(truth.problem)
    assert result.status is Status.AMBIGUOUS
    ends = sorted(float(found.x[-1]) for found in result.matches[:2])
    assert ends[1] - ends[0] == pytest.approx(50.0, abs=0.1)


def test_unmapped_ground_costs_nothing_and_gains_nothing() -> None:
    """A third of the way is unmapped, and the map says there what would fit elsewhere."""
    truth = a_walk(8, FeatureSet.HV, shift=(4.0, 3.0), region_sd=8.0)
    grid_map = truth.problem.grid_map
    support, mean = grid_map.support.copy(), grid_map.mean.copy()
    column = int((truth.x[40] - grid_map.x0) / grid_map.cell_m)
    support[:, column:], mean[:, :, column:] = 9.0, truth.problem.profile.values.mean(axis=0)[:, None, None]
    holed = replace(grid_map, support=support, mean=mean)
    result = match(replace(truth.problem, grid_map=holed))
    assert end_error(truth, result) < 0.3
    nowhere = replace(grid_map, support=np.full(grid_map.shape, 9.0, dtype=np.float32))
    empty = match(replace(truth.problem, grid_map=nowhere))
    assert empty.status is Status.INSUFFICIENT
    assert empty.matches == ()
    assert "mapped" in empty.evidence.note


def test_a_region_off_the_map_finds_nothing() -> None:
    truth = a_walk(9)
    far = replace(truth.problem, region=Region(900.0, 900.0, np.eye(2)))
    assert match(far).matches == ()
    assert match(far, rotations=5, scales=3).matches == ()


def test_a_constant_field_claims_nothing() -> None:
    truth = a_walk(10)
    flat = replace(truth.problem.grid_map, mean=np.full_like(truth.problem.grid_map.mean, 20.0))
    problem = replace(
        truth.problem, grid_map=flat, profile=replace(truth.problem.profile, values=np.full((60, 3), 20.0))
    )
    for criterion in Criterion:
        assert match(problem, criterion=criterion).status is Status.INSUFFICIENT


def cut(problem: MatchProblem, n: int) -> MatchProblem:
    track = problem.track
    first = {name: getattr(track, name)[:n] for name in ("t", "x", "y", "heading", "cov")}
    profile = replace(problem.profile, values=problem.profile.values[:n])
    return replace(problem, track=replace(track, **first), profile=profile)


@pytest.mark.parametrize("rotations", [1, 0])
@pytest.mark.parametrize("features", FeatureSet)
def test_a_point_is_too_little(features: FeatureSet, rotations: int) -> None:
    result = match(cut(a_walk(11, features).problem, 1), rotations=rotations, scales=rotations)
    assert features is FeatureSet.VECTOR or result.status is not Status.OK
    assert all(np.isfinite(found.cov).all() for found in result.matches)


def test_short_walks_are_claimed_only_where_that_is_right() -> None:
    """Two points: some tell the place, most do not; what is called ok is right nearly always."""
    ok = []
    for seed in range(30):
        truth = a_walk(seed, FeatureSet.HV, shift=(3.0, -4.0))
        result = match(cut(truth.problem, 2))
        if result.status is Status.OK:
            ok.append(np.hypot(result.matches[0].x[-1] - truth.x[1], result.matches[0].y[-1] - truth.y[1]) < 1.5)
    assert 5 < len(ok) < 30
    assert np.mean(ok) >= 0.9


def test_maps_of_few_cells() -> None:
    problem = a_walk(12).problem
    grid_map = problem.grid_map
    for rows, columns in ((1, 1), (1, 30), (30, 1), (2, 2)):
        small = replace(
            grid_map,
            mean=np.ascontiguousarray(grid_map.mean[:, :rows, :columns]),
            sd=np.ascontiguousarray(grid_map.sd[:, :rows, :columns]),
            support=np.ascontiguousarray(grid_map.support[:rows, :columns]),
        )
        assert match(replace(problem, grid_map=small, region=None)).status is not Status.OK


def test_it_is_deterministic_pickles_and_leaves_its_input_alone() -> None:
    truth = a_walk(13, shift=(2.0, 1.0))
    before = pickle.dumps(truth.problem)
    matcher = pickle.loads(pickle.dumps(Magcom(MagcomParameters(rotations=5))))
    one, two = matcher.match(truth.problem), matcher.match(truth.problem)
    np.testing.assert_array_equal(one.matches[0].x, two.matches[0].x)
    assert one.evidence == two.evidence
    assert pickle.dumps(truth.problem) == before


@pytest.mark.timing
@pytest.mark.parametrize("criterion", [Criterion.MAD, Criterion.HAUSDORFF])
def test_the_deadline_is_kept_and_said(criterion: Criterion) -> None:
    problem = replace(a_walk(14, region_sd=10.0).problem, deadline_s=0.02)
    match(problem, rotations=5, scales=5)  # compiled
    began = time.thread_time()
    result = match(problem, criterion=criterion, rotations=361, scales=5)
    assert time.thread_time() - began < 1.5  # the judgement comes on top; without a deadline it takes far longer
    assert not result.evidence.converged
    assert result.evidence.evaluated > 0


def test_bands_of_shifts_are_one_search(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = a_walk(14, region_sd=10.0).problem
    whole = match(problem, rotations=3)
    monkeypatch.setattr(contour_search, "_BAND", 1.0)
    assert match(problem, rotations=3).evidence == whole.evidence


def test_more_poses_than_can_be_tried_are_refused() -> None:
    problem = a_walk(15).problem
    with pytest.raises(InputError, match="rotations"):
        match(problem, rotations=361, scales=61)
    huge = replace(problem, region=replace(problem.region, heading_sd=1e9, scale_sd=0.01))  # type: ignore[type-var]
    with pytest.raises(InputError, match="rotations"):
        match(huge, rotations=0)


def test_more_map_than_can_be_held_is_refused() -> None:
    problem = a_walk(15, region_sd=None).problem
    long = replace(problem.track, x=300.0 * problem.track.x, y=300.0 * problem.track.y)
    with pytest.raises(InputError, match="track"):
        match(replace(problem, track=long), rotations=3, mapped=0.1)


def test_the_ellipses_hold_the_truth() -> None:
    inside, n = 0, 40
    for seed in range(n):
        rng = np.random.default_rng(seed)
        grid_map = field_map(rng, features=FeatureSet.HV, shape=(100, 100), sd_ut=1e-3)
        truth = walk_through(grid_map, rng, start=(10.0, 0.0), n=30, noise_ut=2.0, region_sd=3.0, turns=1.0)
        problem = replace(truth.problem, region=replace(truth.problem.region, heading_sd=1e-6, scale_sd=1e-6))  # type: ignore[type-var]
        found = match(problem, criterion=Criterion.MSD).matches[0]
        away = np.array([found.x[-1] - truth.x[-1], found.y[-1] - truth.y[-1]])
        inside += float(away @ np.linalg.solve(found.cov, away)) <= 5.991
    assert inside >= 0.87 * n


def test_the_objective_is_the_cost_of_a_placement() -> None:
    truth = a_walk(16, shift=(2.0, -1.0), rotation=0.1, scale=1.05)
    objective = PlacementObjective.of(truth.problem)
    placements = np.array([[-2.0, 1.0, 0.1, 1.05], [0.0, 0.0, 0.0, 1.0], [900.0, 0.0, 0.0, 1.0]])
    costs = objective.costs(placements)
    assert costs[0] < 0.25 < costs[1]
    assert np.isinf(costs[2])
    x, y = placed(truth.problem.track.xy, *placements[0])
    np.testing.assert_allclose(x, truth.x, atol=1e-9)
    found = objective.candidate(placements[0], 1.0)
    np.testing.assert_allclose(found.y, y)


def test_the_registry_tells_its_ranges() -> None:
    entry = MATCHERS["magcom"]
    defaults = entry.parameters()
    for name, bound in entry.bounds.items():
        assert bound.low <= getattr(defaults, name) <= bound.high
    assert isinstance(entry.create(defaults), Magcom)


def test_the_answer_lies_between_the_cells() -> None:
    """Shifts lie on a lattice of the map's cells; the truth does not."""
    errors = []
    for seed in range(5):
        truth = a_walk(20 + seed, shift=(0.37 + seed, -0.21), noise_ut=0.01)
        errors.append(end_error(truth, match(truth.problem)))
    assert max(errors) < 0.03
