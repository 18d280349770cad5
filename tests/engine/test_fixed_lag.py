"""Fixed-lag fixes: steps told once more with what came after them, each once, from the lines of the particles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pytest

from app.engine.localization import create_tracker
from app.engine.localization.integrity import CHI2_95, IntegrityPolicy
from app.engine.localization.look_back import LAG_S, LookBack
from app.engine.localization.particle import ParticleTracker
from app.engine.localization.session import SessionState
from app.engine.localization.smoothing import smooth_session
from app.engine.types import Answer, Fix, FixKind, Float64Array, GridMap, IntArray, Prior, Segment, Status, Tracker
from tests.engine.conftest import CORNERS, OneMap
from tests.engine.test_climbing import MAPS, trip
from tests.support.motion import chained, standing
from tests.support.walks import Field, SimulatedWalk, cut, walk_through

PRIOR = Prior("sim", 2.5, 1.5, 3.0)


def segments_of(walk: SimulatedWalk, seconds: float = 5.0) -> list[Segment]:
    return [Segment(samples) for samples in cut(walk.samples, seconds=seconds)]


def answers(
    tracker: Tracker, segments: Sequence[Segment], grid_map: GridMap, prior: Prior = PRIOR, *, seed: int = 1
) -> list[Answer]:
    state, given = tracker.start(prior, seed=seed), list[Answer]()
    for segment in segments:
        given.append(tracker.answer(state, segment, OneMap(grid_map)))
        state = given[-1].state
    return given


def lagged(given: Sequence[Answer]) -> list[Fix]:
    return [fix for answer in given for fix in answer.lagged]


def steps(given: Sequence[Answer]) -> list[Fix]:
    """Fixes of steps: the last of each segment belongs to none."""
    return [fix for answer in given for fix in answer.fixes[:-1]]


@dataclass
class Moment:
    """A step, or the end of a segment (``x`` None): particles as they were, and what resampling made of them."""

    t: float
    weights: Float64Array
    x: Float64Array | None = None
    y: Float64Array | None = None
    ancestors: IntArray | None = None


def recorded(tracker: ParticleTracker, segments: Sequence[Segment], grid_map: GridMap) -> list[Moment]:
    """All that the filter went through, kept."""
    session, moments = SessionState(PRIOR, 1), list[Moment]()
    for segment in segments:
        for fix, moved in tracker.walk(session, segment, OneMap(grid_map)):
            if moved is None:
                assert session.track is not None
                moments.append(Moment(fix.t, session.track.cloud.p[14].astype(np.float64)))
                continue
            p = moved.weighted.p.astype(np.float64)
            moments.append(Moment(fix.t, p[14], p[0], p[1], moved.ancestors))
    return moments


def by_brute_force(moments: Sequence[Moment], at: int) -> tuple[Float64Array, Float64Array]:
    """Mean and covariance at a step, from the first moment that lies the lag after it, particle by particle."""
    now = next(k for k in range(at, len(moments)) if moments[k].t >= moments[at].t + LAG_S)
    places = []
    for particle in range(len(moments[now].weights)):
        line = particle
        for k in range(now - 1, at - 1, -1):
            ancestors = moments[k].ancestors
            line = line if ancestors is None else int(ancestors[line])
        places.append((moments[at].x[line], moments[at].y[line]))
    return np.average(places, axis=0, weights=moments[now].weights), np.cov(
        np.array(places).T, aweights=moments[now].weights, ddof=0
    )


class TestLines:
    @pytest.mark.parametrize("seconds", [5.0, 1.7, 20.0])
    def test_a_step_is_where_its_lines_were(self, walk: SimulatedWalk, field_map: GridMap, seconds: float) -> None:
        """Against the genealogy followed back particle by particle."""
        tracker = ParticleTracker(create_tracker("particle", {"particles": 150}).parameters)
        segments = segments_of(walk, seconds)[: int(40 / seconds)]
        given = answers(tracker, segments, field_map)
        moments, policy = recorded(tracker, segments, field_map), IntegrityPolicy()
        assert sum(moment.ancestors is not None for moment in moments) > 5
        told = lagged(given)
        assert len(told) > 40
        index = {moment.t: k for k, moment in enumerate(moments) if moment.x is not None}
        scale = policy.covariance_scale * policy.lagged_scale
        for fix in told:
            mean, cov = by_brute_force(moments, index[fix.t])
            np.testing.assert_allclose([fix.x, fix.y], mean, atol=0.01)
            claimed = np.array([[fix.cov_xx, fix.cov_xy], [fix.cov_xy, fix.cov_yy]])
            np.testing.assert_allclose(claimed, scale * cov + policy.covariance_floor * np.eye(2), rtol=0.02, atol=0.01)

    def test_what_comes_later_helps(self, walk: SimulatedWalk, field_map: GridMap) -> None:
        """From a poor start the first steps are told better five seconds later, and better still afterwards."""
        prior, segments = Prior("sim", 2.0, 4.5, 3.0), segments_of(walk)
        given = answers(ParticleTracker(), segments, field_map, prior)
        smooth = smooth_session(ParticleTracker(), prior, segments, OneMap(field_map), seed=1)

        def early(fixes: Sequence[Fix]) -> float:
            own = [fix for fix in fixes if fix.t < walk.samples.t[0] + 8.0]
            return float(np.mean([np.hypot(*(walk.at(fix.t) - [fix.x, fix.y])) for fix in own]))

        assert early(smooth) < early(lagged(given)) < 0.9 * early(steps(given))

    def test_the_claimed_ellipse_holds_the_truth(self, field: Field, field_map: GridMap) -> None:
        rng, inside, wide = np.random.default_rng(11), list[bool](), list[float]()
        tracker = create_tracker("particle", {"particles": 1000})
        for i in range(15):
            corners = CORNERS[: int(rng.integers(3, 7))]
            w = walk_through(corners, field, rng, hard_iron=rng.normal(0, 3, 3), carry=rng.normal(0, 0.1))
            start = w.xy[0] + rng.uniform(-1.5, 1.5, 2)
            for fix in lagged(answers(tracker, segments_of(w), field_map, Prior("sim", *start, 3.0), seed=i)):
                d = w.at(fix.t) - [fix.x, fix.y]
                cov = np.array([[fix.cov_xx, fix.cov_xy], [fix.cov_xy, fix.cov_yy]])
                inside.append(bool(d @ np.linalg.solve(cov, d) <= CHI2_95))
                wide.append(float(np.sqrt(np.linalg.eigvalsh(cov)[-1])))
        assert np.mean(inside) > 0.9
        assert np.median(wide) < 3.0


class TestStream:
    @pytest.mark.parametrize("seconds", [5.0, 1.0, 13.0])
    def test_each_step_is_told_once_and_not_before_its_time(
        self, walk: SimulatedWalk, field_map: GridMap, seconds: float
    ) -> None:
        given = answers(ParticleTracker(), segments_of(walk, seconds), field_map)
        told, end = lagged(given), given[-1].fixes[-1].t
        assert [fix.t for fix in told] == [fix.t for fix in steps(given) if fix.t <= end - LAG_S]
        assert {fix.kind for fix in told} == {FixKind.FIXED_LAG}
        assert {fix.kind for answer in given for fix in answer.fixes} == {FixKind.FILTERED}
        last = -np.inf
        for answer in given:
            now = answer.fixes[-1].t
            assert all(last - LAG_S < fix.t <= now - LAG_S for fix in answer.lagged)
            last = now

    def test_the_answer_of_the_moment_is_that_of_a_step(self, walk: SimulatedWalk, field_map: GridMap) -> None:
        for name in ("particle", "dead_reckoning"):
            tracker = create_tracker(name)
            state = tracker.start(PRIOR, seed=1)
            for segment in segments_of(walk)[:3]:
                answer = tracker.answer(state, segment, OneMap(field_map))
                state, fixes = tracker.step(state, segment, OneMap(field_map))
                assert (state, fixes) == (answer.state, answer.fixes)

    def test_dead_reckoning_looks_back_on_nothing(self, walk: SimulatedWalk, field_map: GridMap) -> None:
        assert lagged(answers(create_tracker("dead_reckoning"), segments_of(walk), field_map)) == []

    def test_who_stands_still_is_told_of_the_last_steps(self, walk: SimulatedWalk, field_map: GridMap) -> None:
        first = cut(walk.samples, seconds=12.0)[0]
        rest = standing(8.0, np.random.default_rng(4), at=first, gyro_offset=np.zeros(3))
        given = answers(ParticleTracker(), [Segment(s) for s in cut(chained(first, rest), seconds=4.0)], field_map)
        late = [fix.t for fix in steps(given) if fix.t > first.t[-1] - 2.0]
        assert late
        assert set(late) <= {fix.t for fix in lagged(given)}

    def test_the_lines_survive_the_state(self, walk: SimulatedWalk, field_map: GridMap) -> None:
        given = answers(ParticleTracker(), segments_of(walk)[:3], field_map)
        payload = given[-1].state.payload
        session = SessionState.decode(payload)
        assert session.encode() == payload
        open_steps = session.open_steps
        assert [step.t for step in open_steps] == [
            fix.t for fix in steps(given) if fix.t > given[-1].fixes[-1].t - LAG_S
        ]
        names = ("settled", "doubted", "borne_out", "found")
        assert all(isinstance(getattr(s.integrity, name), bool) for s in open_steps for name in names)
        # a particle's line at a step: two int16
        assert {(step.lines.shape, step.lines.dtype.str) for step in open_steps} == {((2000, 2), "<i2")}


class TestEnds:
    @staticmethod
    def after(walk: SimulatedWalk, grid_map: GridMap, gap_s: float) -> list[Answer]:
        pieces = cut(walk.samples, seconds=5.0)
        later = [replace(samples, t=samples.t + gap_s) for samples in pieces[3:6]]
        return answers(ParticleTracker(), [Segment(samples) for samples in (*pieces[:3], *later)], grid_map)

    @pytest.mark.parametrize("gap_s", [3.0, 30.0, 600.0])
    def test_a_gap_ends_the_lines(self, walk: SimulatedWalk, field_map: GridMap, gap_s: float) -> None:
        """Steps still open are told with the next answer, whatever it brings: with what was known before the gap."""
        given = self.after(walk, field_map, gap_s)
        before = [step.t for step in steps(given[:3])]
        assert [fix.t for fix in lagged(given[:4])][: len(before)] == before
        closing = [fix for fix in given[3].lagged if fix.t in before]
        session = SessionState.decode(given[2].state.payload)
        assert session.track is not None
        expected = [step.estimate(session.track.cloud.p[14]) for step in session.open_steps]
        assert [(fix.x, fix.y) for fix in closing] == [(e.x, e.y) for e in expected]
        assert len(closing) >= 5
        fourth = cut(walk.samples, seconds=5.0)[3]
        turned = Segment(replace(fourth, t=fourth.t + gap_s, mag=-fourth.mag))
        other = answers(ParticleTracker(), [*segments_of(walk)[:3], turned], field_map)
        assert other[3].fixes != given[3].fixes
        assert [fix for fix in other[3].lagged if fix.t in before] == closing

    def test_after_a_gap_lines_begin_anew(self, walk: SimulatedWalk, field_map: GridMap) -> None:
        given = self.after(walk, field_map, 3.0)
        told, end = lagged(given), given[-1].fixes[-1].t
        last_before = steps(given[:3])[-1].t
        assert [fix.t for fix in told] == [fix.t for fix in steps(given) if fix.t <= max(last_before, end - LAG_S)]

    def test_a_search_has_no_lines(self, walk: SimulatedWalk, field_map: GridMap) -> None:
        """What is told begins with the first segment that is tracked."""
        given = answers(ParticleTracker(), segments_of(walk), field_map, Prior("sim"))
        tracked = [SessionState.decode(answer.state.payload).track is not None for answer in given]
        first = tracked.index(True) + 1
        assert first >= 3
        assert lagged(given[:first]) == []
        end = given[-1].fixes[-1].t
        assert [fix.t for fix in lagged(given)] == [fix.t for fix in steps(given[first:]) if fix.t <= end - LAG_S]

    def test_a_change_of_level_ends_them(self) -> None:
        """Every step before it is told, on the level it was on."""
        tracker, source = ParticleTracker(), _Levels()
        state, told, due = tracker.start(Prior(None), seed=1), list[Fix](), list[float]()
        for piece in trip(4.5):
            tracked = SessionState.decode(state.payload).track is not None
            answer = tracker.answer(state, piece, source)
            state = answer.state
            still = SessionState.decode(state.payload).track is not None
            due += [fix.t for fix in answer.fixes[:-1]] if tracked and still else []
            if tracked and not still:
                assert SessionState.decode(state.payload).open_steps == ()
                assert [fix.t for fix in (*told, *answer.lagged)] == due
                assert {fix.level_id for fix in answer.lagged} <= {"F1"}
            told += answer.lagged
        assert {fix.level_id for fix in told} == {"F1", "F2"}
        assert [fix.t for fix in told] == sorted({fix.t for fix in told})


class _Levels:
    def level_ids(self) -> tuple[str, ...]:
        return tuple(MAPS)

    def grid_map(self, level_id: str) -> GridMap:
        return MAPS[level_id]


def test_a_smoothed_track_says_so(walk: SimulatedWalk, field_map: GridMap) -> None:
    fixes = smooth_session(ParticleTracker(), PRIOR, segments_of(walk)[:3], OneMap(field_map), seed=1)
    assert {fix.kind for fix in fixes} == {FixKind.SMOOTHED}


@pytest.mark.parametrize("found", [False, True])
def test_that_the_place_was_found_later_counts_for_the_steps_before(
    walk: SimulatedWalk, field_map: GridMap, found: bool
) -> None:
    given = answers(ParticleTracker(), segments_of(walk)[:3], field_map)
    session = SessionState.decode(given[-1].state.payload)
    track = session.track
    assert track is not None
    steps_then = [replace(step, integrity=replace(step.integrity, settled=False)) for step in session.open_steps]
    track.integrity = replace(track.integrity, settled=found)
    end = replace(given[-1].fixes[-1], t=given[-1].fixes[-1].t + LAG_S)
    told = LookBack(steps_then, track, IntegrityPolicy()).take(track, end, None)
    assert {fix.status for fix in told} == {Status.OK if found else Status.INSUFFICIENT}
