"""A batch method served segment by segment, with the plainest matcher there is."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np
import pytest

from app.engine.localization.matched import MatcherTracker
from app.engine.localization.window import STEPS
from app.engine.matching import Candidate, MatchProblem, MatchResult, conclude, read_map
from app.engine.types import Fix, FixKind, GridMap, Prior, RouteLines, Segment, Status
from tests.engine.conftest import OneMap
from tests.support.walks import SimulatedWalk, cut

START = Prior("sim", 2.0, 2.0, 2.0, heading=0.0, heading_sd=0.1)


@dataclass(frozen=True)
class Shifts:
    """Mean absolute difference over a lattice of shifts, without the readings' mean."""

    asked: tuple[list[MatchProblem]] = ([],)

    def match(self, problem: MatchProblem) -> MatchResult:
        self.asked[0].append(problem)
        reach = 3.0 if problem.region is not None else 25.0
        steps = np.arange(-reach, reach + 0.01, 0.5)
        candidates = []
        for dx, dy in itertools.product(steps, steps):
            x, y = problem.track.x + dx, problem.track.y + dy
            difference = read_map(problem.grid_map, problem.profile.features, x, y).mean - problem.profile.values
            cost = float(np.abs(difference - difference.mean(axis=0)).mean())
            candidates.append(Candidate(x, y, cost))
        best = sorted(candidates, key=lambda one: one.cost)[:5]
        return conclude(problem, best, evaluated=len(candidates))


def tracker_of(**needs: bool) -> MatcherTracker:
    return MatcherTracker("shifts", Shifts(([],)), **needs)


def follow(
    tracker: MatcherTracker, walk: SimulatedWalk, grid_map: GridMap, prior: Prior = START
) -> tuple[list[Fix], list[Fix]]:
    state = tracker.start(prior, seed=3)
    fixes: list[Fix] = []
    lagged: list[Fix] = []
    for samples in cut(walk.samples, seconds=5.0):
        answer = tracker.answer(state, Segment(samples), OneMap(grid_map))
        state = answer.state
        fixes += answer.fixes
        lagged += answer.lagged
    return fixes, lagged


def errors(fixes: list[Fix], walk: SimulatedWalk) -> np.ndarray:
    return np.array([np.hypot(*(walk.at(fix.t) - [fix.x, fix.y])) for fix in fixes])


def test_a_match_holds_back_drift(walk: SimulatedWalk, field_map: GridMap) -> None:
    fixes, lagged = follow(tracker_of(), walk, field_map)
    assert np.median(errors(fixes, walk)) < 2.0
    assert np.median(errors(lagged, walk)) <= np.median(errors(fixes, walk)) + 0.2
    assert {fix.kind for fix in lagged} == {FixKind.FIXED_LAG}
    assert not any(fix.sure for fix in fixes)


def test_fixes_within_a_segment_know_nothing_of_its_end(walk: SimulatedWalk, field_map: GridMap) -> None:
    """What comes after a step in its own segment must not change its filtered fix."""
    tracker = tracker_of()
    first, second = cut(walk.samples, seconds=5.0)[:2]
    state = tracker.answer(tracker.start(START, seed=3), Segment(first), OneMap(field_map)).state
    spoilt = second.mag.copy()
    spoilt[len(spoilt) // 2 :] += 20.0
    whole = tracker.answer(state, Segment(second), OneMap(field_map)).fixes
    other = tracker.answer(state, Segment(replace(second, mag=spoilt)), OneMap(field_map)).fixes
    assert whole[:-1] == other[:-1]
    assert whole[-1] != other[-1]


def test_the_last_steps_are_asked_about(walk: SimulatedWalk, field_map: GridMap) -> None:
    tracker = tracker_of()
    follow(tracker, walk, field_map)
    asked = tracker.matcher.asked[0]  # type: ignore[attr-defined]
    assert max(len(problem) for problem in asked) == STEPS
    later = [problem for problem in asked if len(problem) == STEPS]
    assert all(problem.region is not None for problem in later)
    assert later[-1].track.t[-1] > later[0].track.t[-1]


def test_without_a_start_the_level_is_searched(walk: SimulatedWalk, field_map: GridMap) -> None:
    fixes, _ = follow(tracker_of(), walk, field_map, Prior("sim", heading=0.0, heading_sd=0.1))
    assert fixes[0].status is Status.INSUFFICIENT
    assert fixes[0].cov_xx > 50.0
    assert errors(fixes, walk)[-1] < 4.0


@pytest.mark.parametrize("needs", ["needs_routes", "needs_region"])
def test_a_method_that_cannot_be_asked_claims_nothing(walk: SimulatedWalk, field_map: GridMap, needs: str) -> None:
    tracker = tracker_of(**{needs: True})
    fixes, lagged = follow(tracker, walk, field_map, Prior("sim"))
    assert tracker.matcher.asked[0] == []  # type: ignore[attr-defined]
    assert {fix.status for fix in fixes} == {Status.INSUFFICIENT}
    assert lagged == []


def test_lines_of_the_map_are_read(walk: SimulatedWalk, field_map: GridMap) -> None:
    line = np.array([[2.0, 2.0], [38.0, 2.0]], dtype=np.float32)
    tracker = tracker_of(needs_routes=True)
    follow(tracker, walk, replace(field_map, routes=RouteLines(line, np.array([0], dtype=np.int32))))
    (route,) = tracker.matcher.asked[0][0].routes  # type: ignore[attr-defined]
    assert route.x[-1] == pytest.approx(38.0, abs=0.3)


def test_a_method_by_time_needs_no_steps(walk: SimulatedWalk, field_map: GridMap) -> None:
    """A cart that makes no steps and tells no speed still gives readings one after the other."""
    samples = walk.samples
    smooth = replace(samples, acc=np.tile([0.0, 0.0, 9.81], (len(samples), 1)))
    cart = SimulatedWalk(smooth, walk.xy, walk.heading)
    tracker = tracker_of(needs_odometry=False)
    follow(tracker, cart, field_map)
    assert len(tracker.matcher.asked[0][-1]) == STEPS  # type: ignore[attr-defined]
    assert not follow(tracker_of(), cart, field_map)[1]
