"""Tracks that are not where they are tracked: wrong priors, walkers carried elsewhere, and tracks that are right."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from app.engine.filtering import Cloud, ParticleNoise, prepare_grid
from app.engine.inertial import StepEvents, advance
from app.engine.localization.aids import RadioSighting
from app.engine.localization.initial import InitialSpread
from app.engine.localization.integrity import Integrity, IntegrityPolicy
from app.engine.localization.look_back import LAG_S
from app.engine.localization.lost import LostPolicy, Watch, convict, misfit, suspected
from app.engine.localization.particle import ParticleTracker
from app.engine.localization.profile import newest
from app.engine.localization.radio import RadioScan
from app.engine.localization.search import SearchPolicy, search
from app.engine.localization.session import SessionState, Track, estimate_of
from app.engine.localization.smoothing import smooth_session
from app.engine.localization.trail import SCANS, STEPS, Trail
from app.engine.types import FeatureSet, Fix, GridMap, ImuSamples, Prior, Segment, Status, TrackerState
from tests.engine.conftest import OneMap
from tests.support.walks import Field, SimulatedWalk, cut, true_map, walk_through

EXTENT = (0.0, 0.0, 90.0, 50.0)
HERE = np.array([[5.0, 6.0], [55.0, 6.0], [55.0, 26.0], [15.0, 26.0]])
THERE = np.array([[25.0, 40.0], [80.0, 40.0], [80.0, 15.0], [60.0, 15.0]])
"""Begins in the direction in which the first leg of ``HERE`` goes on."""


@pytest.fixture(scope="module")
def hall(field: Field) -> GridMap:
    return true_map(field, EXTENT)


def fixes_of(walk: SimulatedWalk, hall: GridMap, prior: Prior, seed: int = 1) -> tuple[list[Fix], SessionState]:
    tracker, session = ParticleTracker(), SessionState(prior, seed)
    fixes: list[Fix] = []
    for samples in cut(walk.samples, seconds=5.0):
        fixes += [fix for fix, _ in tracker.walk(session, Segment(samples), OneMap(hall))]
        session = SessionState.decode(session.encode())  # as the next worker gets it
    return fixes, session


def away(walk: SimulatedWalk, fixes: list[Fix]) -> np.ndarray:
    return np.array([np.hypot(*(walk.at(fix.t) - [fix.x, fix.y])) for fix in fixes])


def kidnapped(field: Field, first_m: float) -> tuple[SimulatedWalk, float]:
    """A walk through ``HERE`` that goes on in ``THERE`` after so many metres, without a pause; and when."""
    here = walk_through(np.array([HERE[0], HERE[0] + [first_m, 0.0]]), field, np.random.default_rng(5))
    t = float(here.samples.t[-1])
    there = walk_through(THERE, field, np.random.default_rng(6), t0=t + 0.02)
    joined = ImuSamples(
        *(np.concatenate([getattr(w.samples, name) for w in (here, there)]) for name in ("t", "mag", "acc", "gyro"))
    )
    xy, heading = (np.concatenate([getattr(w, name) for w in (here, there)]) for name in ("xy", "heading"))
    return SimulatedWalk(joined, xy, heading), t


def test_a_wrong_prior_is_found_out(field: Field, hall: GridMap) -> None:
    """Told to be 25 m off the walk: soon nothing is claimed there, and the right place is found."""
    walk = walk_through(HERE, field, np.random.default_rng(3), hard_iron=np.array([3.0, -2.0, 4.0]))
    fixes, session = fixes_of(walk, hall, Prior("sim", 10.0, 31.0, 3.0))
    far = away(walk, fixes)
    claimed = np.array([fix.sure for fix in fixes])
    assert session.losses == 1
    after = walk.samples.t[0] + 35.0  # 41 m
    assert not any(sure and off > 5.0 for fix, sure, off in zip(fixes, claimed, far, strict=True) if fix.t > after)
    assert fixes[-1].status is Status.OK
    assert far[-1] < 3.0


def test_a_walker_carried_elsewhere_is_found(field: Field, hall: GridMap) -> None:
    """From one step to the next the walker is 36 m off: a tram, or samples of another day. No gap tells of it."""
    walk, jump_t = kidnapped(field, 40.0)
    fixes, session = fixes_of(walk, hall, Prior("sim", 5.5, 6.5, 3.0))
    far = away(walk, fixes)
    before = np.array([fix.t <= jump_t for fix in fixes])
    assert session.losses >= 1
    assert np.median(far[before]) < 2.0
    assert far[-1] < 3.0
    assert fixes[-1].status is Status.OK
    late = np.array([fix.t > jump_t + 40.0 for fix in fixes])  # 47 m
    assert not any(fix.sure and off > 5.0 for fix, off, then in zip(fixes, far, late, strict=True) if then)


def test_between_loss_and_confirmation_nothing_is_claimed(field: Field, hall: GridMap) -> None:
    """With a rule of confirmation that nothing meets, the search goes on to the end."""
    walk, _ = kidnapped(field, 40.0)
    tracker = ParticleTracker(policy=IntegrityPolicy(found=1.1))
    session = SessionState(Prior("sim", 5.5, 6.5, 3.0), 1)
    quests = 0
    for samples in cut(walk.samples, seconds=5.0):
        fixes = [fix for fix, _ in tracker.walk(session, Segment(samples), OneMap(hall))]
        if session.losses and session.quest is not None:
            quests += 1
            assert fixes[-1].status in (Status.AMBIGUOUS, Status.INSUFFICIENT)
            assert not fixes[-1].sure
            assert fixes[-1].hypotheses
    assert quests >= 1


def test_looking_back_from_a_loss_nothing_is_claimed(field: Field, hall: GridMap) -> None:
    """The steps that were open when the track was given up are told again, now that it is known to be wrong."""
    walk, _ = kidnapped(field, 40.0)
    tracker = ParticleTracker()
    state, losses = tracker.start(Prior("sim", 5.5, 6.5, 3.0), seed=1), 0
    told_at_a_loss: list[Fix] = []
    for samples in cut(walk.samples, seconds=5.0):
        answer = tracker.answer(state, Segment(samples), OneMap(hall))
        state, now = answer.state, SessionState.decode(answer.state.payload).losses
        open_then = samples.t[-1] - LAG_S - 0.5  # what came before was told before the end of the segment
        told_at_a_loss += [fix for fix in answer.lagged if now > losses and fix.t > open_then]
        losses = now
    assert told_at_a_loss
    assert not any(fix.sure or fix.status is Status.OK for fix in told_at_a_loss)


def test_a_doubted_track_teaches_nothing_of_the_device(field: Field, hall: GridMap) -> None:
    walk = walk_through(HERE, field, np.random.default_rng(3), hard_iron=np.array([3.0, -2.0, 4.0]))
    tracker = ParticleTracker()
    _, session = fixes_of(walk, hall, Prior("sim", 6.0, 7.0, 3.0))
    assert tracker.learned(TrackerState(tracker.method, session.encode())) is not None
    assert session.track is not None
    session.track.integrity = replace(session.track.integrity, doubted=True)
    assert tracker.learned(TrackerState(tracker.method, session.encode())) is None


def test_right_tracks_are_kept(field: Field, hall: GridMap) -> None:
    for seed in range(6):
        rng = np.random.default_rng(100 + seed)
        walk = walk_through(HERE, field, rng, hard_iron=rng.normal(0, 3, 3), carry=rng.normal(0, 0.1))
        _, session = fixes_of(walk, hall, Prior("sim", 6.0, 7.0, 3.0), seed)
        assert session.losses == 0
        assert session.track is not None
        assert not session.track.integrity.doubted


def test_the_state_stays_small(field: Field, hall: GridMap) -> None:
    walk = walk_through(HERE, field, np.random.default_rng(3))
    _, session = fixes_of(walk, hall, Prior("sim", 6.0, 7.0, 3.0))
    assert session.track is not None
    assert len(session.track.trail.events) == len(session.track.trail.places) == STEPS
    whole = len(session.encode())
    session.track.trail = Trail()
    assert whole - len(session.encode()) < 10_000


def test_steps_join_across_segments(field: Field, hall: GridMap) -> None:
    """What is kept are the walk's newest steps, each with the place before it."""
    walk = walk_through(HERE, field, np.random.default_rng(3))
    fixes, session = fixes_of(walk, hall, Prior("sim", 6.0, 7.0, 3.0))
    assert session.track is not None
    steps = {fix.t: fix for fix in fixes}
    trail = session.track.trail
    assert (np.diff(trail.events.t) > 0.0).all()
    for earlier, place in zip(trail.events.t[:-1], trail.places[1:], strict=True):
        assert (steps[earlier].x, steps[earlier].y) == (place[0], place[1])


def test_the_likelihood_of_a_walk_knows_how_much_was_open(field: Field, hall: GridMap) -> None:
    """Told the place, a walk is more likely than from anywhere, by the share of ground that fits: its Occam factor."""
    walk = walk_through(HERE[:2], field, np.random.default_rng(3))
    _, events = advance(None, walk.samples)
    grids = {"sim": prepare_grid(hall, FeatureSet.VECTOR)}

    def log_likelihood(prior: Prior, particles: int) -> float:
        return search(
            newest(events, 40), grids, prior, particles=particles, report=1, spread=InitialSpread(),
            policy=SearchPolicy(), rng=np.random.default_rng(0),
        ).log_likelihood  # fmt: skip

    first = walk.at(float(newest(events, 40).t[0]))
    there = log_likelihood(Prior("sim", first[0], first[1], 3.0), 5000)
    elsewhere = log_likelihood(Prior("sim", first[0], first[1] + 25.0, 3.0), 5000)
    anywhere = log_likelihood(Prior("sim"), 60_000)
    assert there - anywhere == pytest.approx(np.log(90.0 * 50.0 / (np.pi * 3.0**2)), abs=1.5)
    assert elsewhere < there - 10.0


def test_levels_share_the_likelihood(field: Field, hall: GridMap) -> None:
    """A second level that does not fit doubles what is open: half the likelihood."""
    walk = walk_through(HERE[:2], field, np.random.default_rng(3))
    events = newest(advance(None, walk.samples)[1], 40)
    grid = prepare_grid(hall, FeatureSet.VECTOR)
    other = prepare_grid(true_map(Field.random(np.random.default_rng(9)), EXTENT), FeatureSet.VECTOR)
    found = [
        search(
            events, grids, Prior(None, heading=0.0, heading_sd=0.1), particles=60_000 * len(grids), report=1,
            spread=InitialSpread(), policy=SearchPolicy(), rng=np.random.default_rng(0),
        ).log_likelihood
        for grids in ({"sim": grid}, {"sim": grid, "other": other})
    ]  # fmt: skip
    assert found[0] - found[1] == pytest.approx(np.log(2.0), abs=0.5)


@pytest.mark.parametrize("features", list(FeatureSet))
def test_the_misfit_compares_with_the_peak_of_the_density(hall: GridMap, features: FeatureSet) -> None:
    """A reading right on the map has about none, one that is off has much; whatever the map's deviation."""
    grid, tracker, cloud = prepare_grid(hall, features), ParticleTracker(), Cloud.empty(3)
    for sd in (0.5, 5.0):
        wide = replace(grid, nodes=grid.nodes.copy())
        wide.nodes[..., 3:5] = sd**2
        still = estimate_of(cloud, wide)
        variance = sd**2 + (tracker.noise.field * grid.noise_sd[1]) ** 2
        rho = (sd**2 * np.exp(-0.65 / 5.0) + (variance - sd**2) * np.exp(-0.65 / 2.0)) / variance
        channels = {FeatureSet.VECTOR: 3, FeatureSet.HV: 2, FeatureSet.TOTAL: 1}[features]
        peak = (variance * (1.0 - rho**2)) ** (-0.5 * channels)
        assert misfit(replace(still, likelihood=peak), wide, ParticleNoise(), 0.65) == pytest.approx(0.0, abs=1e-6)
        assert misfit(replace(still, likelihood=peak / 9.0), wide, ParticleNoise(), 0.65) == pytest.approx(np.log(9.0))


def test_scans_of_one_place_are_kept_once() -> None:
    def scan(t: float, way: float) -> RadioSighting:
        return RadioSighting(RadioScan(t, t, ("a",), np.array([-60.0])), way)

    trail = Trail().heard([scan(0.0, 0.0), scan(2.0, 1.0), scan(4.0, 5.0)])
    assert [s.t for s in trail.sightings] == [0.0, 4.0]
    trail = trail.heard([scan(10.0 + k, 10.0 * k) for k in range(1, 30)])
    assert len(trail.sightings) == SCANS
    assert trail.sightings[-1].t == 39.0


def test_a_smoothed_track_breaks_where_it_was_lost(field: Field, hall: GridMap) -> None:
    """Lines of particles do not lead from one place to the other, and what was lost in the end is not claimed."""
    walk, jump_t = kidnapped(field, 40.0)
    segments = [Segment(samples) for samples in cut(walk.samples, seconds=5.0)]
    smooth = smooth_session(ParticleTracker(), Prior("sim", 5.5, 6.5, 3.0), segments, OneMap(hall), seed=1)
    assert (np.diff([fix.t for fix in smooth]) > 0).all()
    far = away(walk, list(smooth))
    assert far[-1] < 3.0
    assert not any(fix.sure and off > 5.0 for fix, off in zip(smooth, far, strict=True))
    assert len(smooth) > 60
    assert any(fix.t < jump_t for fix in smooth)


def test_a_track_that_may_not_be_lost_is_followed(field: Field, hall: GridMap) -> None:
    """The policy decides: with odds that nothing reaches, the wrong prior is believed to the end."""
    walk = walk_through(HERE, field, np.random.default_rng(3))
    tracker, session = ParticleTracker(lost=LostPolicy(lost=1e9)), SessionState(Prior("sim", 10.0, 31.0, 3.0), 1)
    for samples in cut(walk.samples, seconds=5.0):
        fixes = [fix for fix, _ in tracker.walk(session, Segment(samples), OneMap(hall))]
    assert session.losses == 0
    assert session.track is not None
    assert session.track.integrity.doubted
    assert fixes[-1].status is Status.AMBIGUOUS


class TestVerdict:
    """Odds of elsewhere, beyond a slack of 0.1 nats a step, over 60 steps: what follows from them."""

    @staticmethod
    def tried(hall: GridMap, odds: float, *, mapped: float = 1.0, borne_out: bool = True) -> tuple[bool, Track]:
        cloud = Cloud.empty(3)
        trail = Trail(_steps(60), np.full((60, 4), mapped))
        integrity = Integrity(settled=True, borne_out=borne_out)
        estimate = estimate_of(cloud, prepare_grid(hall, FeatureSet.VECTOR))
        track = Track("sim", FeatureSet.VECTOR, 0.0, cloud, estimate, integrity, trail)
        return convict(track, odds + 6.0, LostPolicy()), track

    @pytest.mark.parametrize(
        ("odds", "before", "lost", "doubted", "borne_out"),
        [
            (-2.0, False, False, False, True),
            (0.0, False, False, False, False),
            (0.0, True, False, False, True),
            (2.0, True, False, True, False),
            (8.0, True, True, False, True),
        ],
    )
    def test_follows_from_the_odds(
        self, hall: GridMap, odds: float, before: bool, lost: bool, doubted: bool, borne_out: bool
    ) -> None:
        found, track = self.tried(hall, odds, borne_out=before)
        assert (found, track.integrity.doubted, track.integrity.borne_out) == (lost, doubted, borne_out)

    def test_unmapped_ground_is_no_ground_for_a_verdict(self, hall: GridMap) -> None:
        assert not self.tried(hall, 12.0, mapped=0.5)[0]
        assert self.tried(hall, 18.0, mapped=0.5)[0]

    def test_a_track_that_is_borne_out_is_checked_more_and_more_seldom(self, hall: GridMap) -> None:
        _, track = self.tried(hall, -5.0)
        pauses = [track.trail.pause]
        for _ in range(4):
            convict(track, 0.0, LostPolicy())
            pauses.append(track.trail.pause)
        assert pauses == [15, 30, 60, 60, 60]
        convict(track, 8.0, LostPolicy())
        assert track.trail.pause == 15

    def test_nothing_is_sure_before_it_is_borne_out(self, field: Field, hall: GridMap) -> None:
        walk = walk_through(HERE, field, np.random.default_rng(3))
        fixes, session = fixes_of(walk, hall, Prior("sim", 6.0, 7.0, 3.0))
        first = next(i for i, fix in enumerate(fixes) if fix.sure)
        assert first >= LostPolicy().least
        assert session.track is not None
        assert session.track.integrity.borne_out
        assert any(fix.status is Status.OK for fix in fixes[:first])


def test_a_scan_that_fits_elsewhere_makes_a_track_suspect(hall: GridMap) -> None:
    grid, cloud = prepare_grid(hall, FeatureSet.VECTOR), Cloud.empty(3)
    track = Track("sim", FeatureSet.VECTOR, 0.0, cloud, estimate_of(cloud, grid), Integrity(borne_out=True))
    watched = Watch(track, grid, ParticleNoise(), LostPolicy())
    assert not watched.heard(None)
    assert watched.heard(4.0)
    events = _steps(20)
    for i in range(20):
        watched.before(replace(track.estimate, mapped=1.0))
        watched.after(replace(track.estimate, mapped=0.0), events, i)  # the field tells nothing here
    watched.keep(track, events, (), away=False)
    assert suspected(track, LostPolicy())


def _steps(n: int) -> StepEvents:
    flags = np.zeros(n, dtype=bool)
    number = np.zeros(n)
    return StepEvents(
        np.arange(float(n)), number, number, number, np.zeros((n, 3)), number, flags, flags, number, flags
    )


def test_on_another_level_the_trail_ends(hall: GridMap) -> None:
    """What was walked there, and before, is no evidence about this one."""
    grid, cloud = prepare_grid(hall, FeatureSet.VECTOR), Cloud.empty(3)
    track = Track("sim", FeatureSet.VECTOR, 0.0, cloud, estimate_of(cloud, grid), Integrity())
    for away, kept in ((False, 5), (False, 10), (True, 0)):
        watched = Watch(track, grid, ParticleNoise(), LostPolicy())
        for _ in range(5):
            watched.before(track.estimate)
        watched.keep(track, _steps(5), (), away=away)
        assert len(track.trail.events) == len(track.trail.places) == kept
