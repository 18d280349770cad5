"""The particle tracker: pedestrian motion and a magnetic map, fused segment by segment."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from app.engine.calibration import SoftIron
from app.engine.errors import StateError
from app.engine.filtering import (
    Advance,
    Cloud,
    Estimate,
    FilterGrid,
    ParticleNoise,
    find_modes,
    prepare_grid,
)
from app.engine.inertial import PedestrianState, StepEvents, advance, gap_before, settled_until
from app.engine.localization.aids import (
    Evaluator,
    Sighting,
    at_way,
    sightings,
)
from app.engine.localization.climbing import watch
from app.engine.localization.distortion import DistortionPolicy, learn
from app.engine.localization.initial import (
    FORGET_S,
    WALKING_M_S,
    InitialSpread,
    cloud_after_gap,
    initial_cloud,
)
from app.engine.localization.integrity import (
    Integrity,
    IntegrityPolicy,
    confirmed,
    search_fix,
    spread,
    tell,
)
from app.engine.localization.look_back import LookBack
from app.engine.localization.lost import Check, LostPolicy, Watch, convict, give_up, suspected
from app.engine.localization.motion import take_step
from app.engine.localization.profile import join, newest, no_steps
from app.engine.localization.radio import RadioMemory
from app.engine.localization.search import Belief, Found, Place, SearchPolicy, search
from app.engine.localization.session import Quest, SessionState, Track, estimate_of, weigh_by
from app.engine.types import (
    Answer,
    DeviceCalibration,
    FeatureSet,
    Fix,
    Float64Array,
    MapSource,
    Prior,
    Segment,
    TrackerState,
)


@dataclass(frozen=True, slots=True)
class ParticleParameters:
    """What a caller may choose; the noise model is fitted, not chosen.

    Attributes
    ----------
    particles : int
        Number of particles once the start is known, 100 to 20,000.
    cold_particles : int
        Number a search begins with while it is not, over all levels together.
    features : FeatureSet
        ``vector`` where the map has it, else the map's own.
    """

    particles: int = 2000
    cold_particles: int = 80_000
    features: FeatureSet = FeatureSet.VECTOR


LEARN_M = 20.0
"""Metres that must have been tracked before a session teaches anything about its device."""


class ParticleTracker:
    """Bias-aware, map-constrained particle filter over the steps of a pedestrian.

    Follows MaLoc's idea (Xie et al., 2014, doi:10.1145/2632048.2632057: particles of position and heading weighted by
    the field), and differs in that the sensor's offset is marginalized, residuals are whitened along the path, the
    map's own standard deviation enters the weight, so that unmapped ground costs nothing and gains nothing, and the
    floor plan bounds where particles stand.
    """

    method = "particle"

    def __init__(
        self,
        parameters: ParticleParameters | None = None,
        noise: ParticleNoise | None = None,
        spread: InitialSpread | None = None,
        policy: IntegrityPolicy | None = None,
        search: SearchPolicy | None = None,
        lost: LostPolicy | None = None,
        distortion: DistortionPolicy | None = None,
    ) -> None:
        self.parameters = parameters or ParticleParameters()
        self.noise = noise or ParticleNoise()
        self.spread = spread or InitialSpread()
        self.policy = policy or IntegrityPolicy()
        self.search = search or SearchPolicy()
        self.lost = lost or LostPolicy()
        self.distortion = distortion or DistortionPolicy()

    def start(self, prior: Prior, *, seed: int) -> TrackerState:
        """State before the first segment."""
        return TrackerState(self.method, SessionState(prior, seed).encode())

    def step(
        self, state: TrackerState, segment: Segment, map_source: MapSource
    ) -> tuple[TrackerState, tuple[Fix, ...]]:
        """Advance by one segment: a fix per confirmed step, and one where steps are settled."""
        answer = self.answer(state, segment, map_source)
        return answer.state, answer.fixes

    def answer(self, state: TrackerState, segment: Segment, map_source: MapSource) -> Answer:
        """Advance like :meth:`step`, and tell steps of some seconds before once more, with what came after them."""
        if state.method != self.method:
            raise StateError(f"state belongs to method {state.method!r}, not {self.method!r}")
        session = SessionState.decode(state.payload)
        look_back = LookBack(session.open_steps, session.track, self.policy)
        fixes: list[Fix] = []
        lagged: list[Fix] = []
        for fix, moved in self.walk(session, segment, map_source):
            fixes.append(fix)
            lagged += look_back.take(session.track, fix, moved)
        session.open_steps = look_back.steps
        last_t = float(segment.samples.t[-1])
        return Answer(TrackerState(self.method, session.encode(), last_t), tuple(fixes), tuple(lagged))

    def learned(self, state: TrackerState) -> DeviceCalibration | None:
        """Offset and stride as the particles have them, once the place is known and not doubted."""
        track = SessionState.decode(state.payload).track
        if track is None or track.integrity.walked_m < LEARN_M or spread(track.estimate) > self.policy.sure_m:
            return None
        if track.integrity.doubted:  # at a wrong place it learns what makes that one fit
            return None
        return track.calibration()

    def walk(
        self, session: SessionState, segment: Segment, map_source: MapSource
    ) -> Iterator[tuple[Fix, Advance | None]]:
        """Advance ``session`` in place: each step's fix with what the filter did, and the fix at the end.

        The next step overwrites the particles of the one before: take what is needed before going on. While the place
        is searched there is no filter to tell of.
        """
        before, t = session.pedestrian, settled_until(segment.samples.t)
        gap = 0.0 if before is None else gap_before(before, segment.samples)
        session.pedestrian, events = advance(before, segment.samples, speed=segment.speed, steps=segment.steps)
        first = first_reading(session.pedestrian, events)
        rng = np.random.default_rng([session.seed, session.count])
        if session.track is None and session.quest is None:
            self._begin(session, map_source, first, rng)
        elif gap > 0.0:
            self._resume(session, gap, map_source, first, rng)
        session.count += 1
        away = watch(session, segment, map_source)
        if away:
            events = replace(events, disturbed=np.ones(len(events), dtype=np.bool_))
        way = session.travelled_m + np.concatenate([[0.0], np.cumsum(events.stride)])
        radio, (memory, seen) = session.aids.radio, sightings(segment, session.aids, session.travelled_m)
        session.aids, session.travelled_m = memory, float(way[-1])
        seen = at_way(seen, events.t, way)
        if session.quest is not None:
            session.quest.sightings += seen
            yield from ((fix, None) for fix in self._search(session, session.quest, events, first, map_source, t))
        elif session.track is not None:
            yield from self._follow(session, session.track, events, seen, radio, first, map_source, t, rng, away=away)

    def _follow(
        self,
        session: SessionState,
        track: Track,
        events: StepEvents,
        seen: Sequence[Sighting],
        radio: RadioMemory,
        first: tuple[float, Float64Array],
        map_source: MapSource,
        t: float,
        rng: np.random.Generator,
        *,
        away: bool,
    ) -> Iterator[tuple[Fix, Advance | None]]:
        """Track the steps of a segment; evidence beside the field counts before the step that follows it."""
        grid = self._grid(map_source, track.level_id)
        evaluator = Evaluator(map_source, (track.level_id,), radio)
        waiting, watched = deque(seen), Watch(track, grid, self.noise, self.lost)
        for i in range(len(events)):
            while waiting and waiting[0].t <= events.t[i]:
                watched.heard(weigh_by(track, evaluator, waiting.popleft()))
            watched.before(track.estimate)
            moved = self._advance(track, grid, events, i, rng_of_step(session.seed, float(events.t[i])))
            watched.after(track.estimate, events, i)
            track.integrity = replace(track.integrity, misfit=watched.misfit)
            if away:
                track.integrity = track.integrity.away()
            yield self._fix(track, float(events.t[i])), moved
        counted = [watched.heard(weigh_by(track, evaluator, sighting)) for sighting in waiting]
        if any(counted):
            track.estimate = estimate_of(track.cloud, grid)
            track.integrity = replace(track.integrity, misfit=watched.misfit)
        session.aids = replace(session.aids, radio=replace(evaluator.memory, last_t=session.aids.radio.last_t))
        if away:
            track.integrity = track.integrity.away()
        watched.keep(track, events, seen, away=away)
        if self._is_lost(session, track, map_source, rng):
            quest = give_up(session, track)
            yield from ((fix, None) for fix in self._search(session, quest, no_steps(), first, map_source, t))
        else:
            yield self._fix(track, t), None

    def _is_lost(self, session: SessionState, track: Track, map_source: MapSource, rng: np.random.Generator) -> bool:
        """Whether a track that explains its readings badly is found elsewhere."""
        if not suspected(track, self.lost):
            return False
        grids = self._grids(map_source, session.prior.level_id)
        evaluator = Evaluator(map_source, tuple(grids))
        pieces = [piece for piece in map(evaluator.evidence, track.trail.sightings) if piece is not None]
        check = Check(grids, pieces, self.spread, self.search, self.lost)
        return convict(track, check.log_odds(track, session.prior.calibration, rng), self.lost)

    def _grid(self, map_source: MapSource, level_id: str) -> FilterGrid:
        grid_map = map_source.grid_map(level_id)
        vector = grid_map.features is FeatureSet.VECTOR
        return prepare_grid(grid_map, self.parameters.features if vector else grid_map.features)

    def _grids(self, map_source: MapSource, level_id: str | None) -> dict[str, FilterGrid]:
        """All levels that the walker may be on: the one that is known, or any."""
        level_ids = map_source.level_ids() if level_id is None else (level_id,)
        return {level_id: self._grid(map_source, level_id) for level_id in level_ids}

    def _begin(
        self,
        session: SessionState,
        map_source: MapSource,
        first: tuple[float, Float64Array],
        rng: np.random.Generator,
    ) -> None:
        """Set out from the prior: on a track if it names a place, else on a quest."""
        prior = session.prior
        if prior.level_id is None or prior.x is None or prior.radius_m > self.policy.search_m:
            session.quest = Quest(prior)
            return
        (heading, reading), iron = first, SoftIron.start(prior.calibration)
        grid = self._grid(map_source, prior.level_id)
        cloud = initial_cloud(prior, grid, iron.correct(reading), self.parameters.particles, self.spread, rng)
        estimate = estimate_of(cloud, grid)
        session.track = Track(prior.level_id, grid.features, heading, cloud, estimate, Integrity(), soft_iron=iron)

    def _resume(
        self,
        session: SessionState,
        gap_s: float,
        map_source: MapSource,
        first: tuple[float, Float64Array],
        rng: np.random.Generator,
    ) -> None:
        """Go on after a gap: the walker moved unseen, so the old place is only where the search begins."""
        track, reach = session.track, WALKING_M_S * gap_s
        if track is None or gap_s > FORGET_S:
            learned = session.prior.calibration if track is None else track.calibration()
            session.track = None
            session.quest = Quest(Prior(session.prior.level_id, calibration=learned))
        elif reach > self.policy.search_m:
            session.track, session.quest = None, Quest(self._about(track, reach))
        else:
            (heading, reading), iron = first, track.soft_iron.after_gap()
            grid = self._grid(map_source, track.level_id)
            cloud = cloud_after_gap(track.cloud, gap_s, grid, iron.correct(reading), track.cloud.n, self.spread, rng)
            session.track = Track(
                track.level_id,
                grid.features,
                heading,
                cloud,
                estimate_of(cloud, grid),
                track.integrity.resumed(),
                soft_iron=iron,
            )

    def _about(self, track: Track, reach: float) -> Prior:
        """What is known of a walker who may have gone ``reach`` metres since the last fix."""
        e = track.estimate
        radius = reach + 2.0 * spread(e)
        return Prior(track.level_id, e.x, e.y, radius, calibration=track.calibration())

    def _search(
        self,
        session: SessionState,
        quest: Quest,
        events: StepEvents,
        first: tuple[float, Float64Array],
        map_source: MapSource,
        t: float,
    ) -> Iterator[Fix]:
        """Look for the place with all steps so far: a fix for each new step and one at ``t``; track it once found."""
        quest.events = events if quest.events is None else join(quest.events, events)
        if len(quest.events) > self.search.window:
            quest.events = newest(quest.events, self.search.window)
            quest.prior = replace(quest.prior, x=None, y=None)  # known of a start that is forgotten by now
            quest.whole = False
            quest.sightings = tuple(s for s in quest.sightings if s.t > quest.events.t[0])
        rng = np.random.default_rng(session.seed)  # the same steps give the same answer: nothing flickers at rest
        grids = self._grids(map_source, quest.prior.level_id)
        if len(quest.events) == 0:
            yield self._unstarted(quest.prior, grids, first[1], t, rng)
            return
        evaluator = Evaluator(map_source, tuple(grids))
        pieces = (evaluator.evidence(sighting) for sighting in quest.sightings)
        found = search(
            quest.events,
            grids,
            quest.prior,
            [piece for piece in pieces if piece is not None],
            particles=self.parameters.cold_particles,
            report=len(events) + self.policy.found_steps,
            spread=self.spread,
            policy=self.search,
            rng=rng,
        )
        walked = float(quest.events.stride.sum())
        beliefs = found.beliefs
        for i in range(len(events)):
            yield search_fix(float(events.t[i]), beliefs[: len(beliefs) - len(events) + i + 1], walked, self.policy)
        yield search_fix(t, beliefs, walked, self.policy, hypotheses=True)
        if confirmed(beliefs, walked, self.policy):
            self._settle(session, quest, found, grids[found.level_id], walked, rng)
            session.aids = replace(session.aids, radio=replace(evaluator.memory, last_t=session.aids.radio.last_t))

    def _settle(
        self,
        session: SessionState,
        quest: Quest,
        found: Found,
        grid: FilterGrid,
        walked: float,
        rng: np.random.Generator,
    ) -> None:
        """From a quest that has found its place to a track there, and to its beginning if the quest knows the way."""
        cloud = found.cloud.thin(self.parameters.particles, float(rng.random()))
        cloud.p[:2] += self.policy.handover_m * rng.standard_normal((2, cloud.n)).astype(np.float32)
        iron = SoftIron.start(quest.prior.calibration)
        headings = no_steps().heading if quest.events is None else quest.events.heading

        def track(heading: float, cloud: Cloud, estimate: Estimate, integrity: Integrity) -> Track:
            return Track(found.level_id, grid.features, heading, cloud, estimate, integrity, soft_iron=iron)

        integrity = Integrity(settled=True, borne_out=not found.beliefs[-1].level_open, found=True)
        now = replace(integrity, walked_m=walked)
        session.track, session.quest = track(float(headings[-1]), cloud, found.beliefs[-1].estimate, now), None
        if quest.whole:
            session.beginning = track(float(headings[0]), found.start, estimate_of(found.start, grid), integrity)

    def _unstarted(
        self, prior: Prior, grids: Mapping[str, FilterGrid], reading: Float64Array, t: float, rng: np.random.Generator
    ) -> Fix:
        """Before the first step nothing is known but the prior."""
        level_id, grid = next(iter(grids.items()))
        cloud = initial_cloud(prior, grid, reading, self.parameters.particles, self.spread, rng)
        belief = Belief((Place(level_id, find_modes(cloud)[0]),), estimate_of(cloud, grid))
        return search_fix(t, (belief,), 0.0, self.policy)

    def _advance(self, track: Track, grid: FilterGrid, events: StepEvents, i: int, rng: np.random.Generator) -> Advance:
        seen = replace(events, mag=track.soft_iron.correct(events.mag)) if track.soft_iron.applied.any() else events
        moved = take_step(track.cloud, grid, self.noise, self.spread, seen, i, track.heading, rng)
        track.cloud, track.estimate = moved.cloud, moved.estimate
        track.heading = float(events.heading[i])
        track.integrity = track.integrity.walked(
            float(events.stride[i]), moved.estimate, self.policy, disturbed=bool(events.disturbed[i])
        )
        learn(track, moved.weighted, grid, events, i, self.noise, self.distortion)
        return moved

    def _fix(self, track: Track, t: float) -> Fix:
        return tell(t, track.level_id, track.estimate, track.integrity, self.policy)


def rng_of_step(seed: int, t: float) -> np.random.Generator:
    """Random numbers of a step at ``t`` (s): the same wherever the recording was cut into segments."""
    return np.random.default_rng([seed, round(t * 1e6)])


def first_reading(pedestrian: PedestrianState, events: StepEvents) -> tuple[float, Float64Array]:
    """Heading (free azimuth, rad) and field (forward, left, up, uT) at the first step, or now if there is none."""
    if len(events):
        return float(events.heading[0]), events.mag[0]
    return float(pedestrian.tail.heading[-1]), pedestrian.tail.mag[-10:].mean(axis=0)
