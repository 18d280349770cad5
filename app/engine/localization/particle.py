"""The particle tracker: pedestrian motion and a magnetic map, fused segment by segment."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from app.engine.errors import StateError
from app.engine.filtering import (
    Advance,
    Cloud,
    Estimate,
    FilterGrid,
    ParticleNoise,
    advance_cloud,
    find_modes,
    prepare_grid,
)
from app.engine.inertial import PedestrianState, StepEvents, advance, gap_before, settled_until
from app.engine.inertial.stride import weinberg
from app.engine.localization import codec
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
    calibrate,
    confirmed,
    judge,
    search_fix,
    spread,
)
from app.engine.localization.profile import join, newest, profile_from, profile_values
from app.engine.localization.search import Belief, Place, SearchPolicy, channels, search
from app.engine.types import (
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


@dataclass(slots=True)
class Track:
    """Place known: level, heading at the last step (free azimuth, rad), particles, estimate."""

    level_id: str
    features: FeatureSet
    heading: float
    cloud: Cloud
    estimate: Estimate
    integrity: Integrity

    def calibration(self) -> DeviceCalibration | None:
        """What the particles say of the device; None if their offsets are not those of three axes."""
        return learned_calibration(self.cloud) if self.features is FeatureSet.VECTOR else None


@dataclass(slots=True)
class Quest:
    """Place unknown: what is known of the start, and the steps since then (all of them if ``whole``)."""

    prior: Prior
    events: StepEvents | None = None
    whole: bool = True


@dataclass(slots=True)
class SessionState:
    """Tracker state, decoded. ``count`` segments have been taken.

    Before the first there is neither ``pedestrian`` nor ``track`` nor ``quest``; then the session is on a quest until
    its place is known, and on a track from there. ``beginning`` is not kept: it is the track's first moment, known once
    the quest has ended.
    """

    prior: Prior
    seed: int
    count: int = 0
    pedestrian: PedestrianState | None = None
    track: Track | None = None
    quest: Quest | None = None
    beginning: Track | None = None

    def encode(self) -> bytes:
        """As bytes."""
        track, quest, pedestrian = self.track, self.quest, self.pedestrian
        values: dict[str, Any] = {"prior": codec.prior_values(self.prior), "seed": self.seed, "count": self.count}
        if pedestrian is not None:
            values["pedestrian"] = codec.pedestrian_values(pedestrian)
        if track is not None:
            values["track"] = {
                "level_id": track.level_id,
                "features": track.features.value,
                "heading": track.heading,
                "particles": track.cloud.p,
                "moved": track.cloud.moved,
                "estimate": asdict(track.estimate),
                "integrity": asdict(track.integrity),
            }
        if quest is not None:
            events = None if quest.events is None else profile_values(quest.events)
            values["quest"] = {"prior": codec.prior_values(quest.prior), "events": events, "whole": quest.whole}
        return codec.pack(values)

    @classmethod
    def decode(cls, payload: bytes) -> SessionState:
        """Inverse of :meth:`encode`; StateError if damaged."""
        values = codec.unpack(payload)
        session = cls(codec.prior_from(values["prior"]), values["seed"], values["count"])
        if "pedestrian" in values:
            session.pedestrian = codec.pedestrian_state(values["pedestrian"])
        if "track" in values:
            track = values["track"]
            session.track = Track(
                level_id=track["level_id"],
                features=FeatureSet(track["features"]),
                heading=track["heading"],
                cloud=Cloud(track["particles"], track["moved"]),
                estimate=Estimate(**track["estimate"]),
                integrity=Integrity(**track["integrity"]),
            )
        if "quest" in values:
            quest = values["quest"]
            events = None if quest["events"] is None else profile_from(quest["events"])
            session.quest = Quest(codec.prior_from(quest["prior"]), events, quest["whole"])
        return session


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
    ) -> None:
        self.parameters = parameters or ParticleParameters()
        self.noise = noise or ParticleNoise()
        self.spread = spread or InitialSpread()
        self.policy = policy or IntegrityPolicy()
        self.search = search or SearchPolicy()

    def start(self, prior: Prior, *, seed: int) -> TrackerState:
        """State before the first segment."""
        return TrackerState(self.method, SessionState(prior, seed).encode())

    def step(
        self, state: TrackerState, segment: Segment, map_source: MapSource
    ) -> tuple[TrackerState, tuple[Fix, ...]]:
        """Advance by one segment: a fix per confirmed step, and one where steps are settled."""
        if state.method != self.method:
            raise StateError(f"state belongs to method {state.method!r}, not {self.method!r}")
        session = SessionState.decode(state.payload)
        fixes = [fix for fix, _ in self.walk(session, segment, map_source)]
        last_t = float(segment.samples.t[-1])
        return TrackerState(self.method, session.encode(), last_t), tuple(fixes)

    def learned(self, state: TrackerState) -> DeviceCalibration | None:
        """Offset and stride as the particles have them, once the place is known."""
        track = SessionState.decode(state.payload).track
        if track is None or track.integrity.walked_m < LEARN_M or spread(track.estimate) > self.policy.sure_m:
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
        session.pedestrian, events = advance(before, segment.samples)
        first = first_reading(session.pedestrian, events)
        rng = np.random.default_rng([session.seed, session.count])
        if session.track is None and session.quest is None:
            self._begin(session, map_source, first, rng)
        elif gap > 0.0:
            self._resume(session, gap, map_source, first, rng)
        session.count += 1
        if session.quest is not None:
            yield from ((fix, None) for fix in self._search(session, session.quest, events, first, map_source, t))
        elif session.track is not None:
            grid = self._grid(map_source, session.track.level_id)
            for i in range(len(events)):
                moved = self._advance(session.track, grid, events, i, rng)
                yield self._fix(session.track, float(events.t[i])), moved
            yield self._fix(session.track, t), None

    def _grid(self, map_source: MapSource, level_id: str) -> FilterGrid:
        grid_map = map_source.grid_map(level_id)
        vector = grid_map.features is FeatureSet.VECTOR
        return prepare_grid(grid_map, self.parameters.features if vector else grid_map.features)

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
        heading, reading = first
        grid = self._grid(map_source, prior.level_id)
        cloud = initial_cloud(prior, grid, reading, self.parameters.particles, self.spread, rng)
        session.track = Track(prior.level_id, grid.features, heading, cloud, estimate_equal(cloud, grid), Integrity())

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
            heading, reading = first
            grid = self._grid(map_source, track.level_id)
            cloud = cloud_after_gap(track.cloud, gap_s, grid, reading, track.cloud.n, self.spread, rng)
            session.track = Track(
                track.level_id, grid.features, heading, cloud, estimate_equal(cloud, grid), track.integrity.resumed()
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
        rng = np.random.default_rng(session.seed)  # the same steps give the same answer: nothing flickers at rest
        level_ids = map_source.level_ids() if quest.prior.level_id is None else (quest.prior.level_id,)
        grids = {level_id: self._grid(map_source, level_id) for level_id in level_ids}
        if len(quest.events) == 0:
            yield self._unstarted(quest.prior, grids, first[1], t, rng)
            return
        found = search(
            quest.events,
            grids,
            quest.prior,
            particles=self.parameters.cold_particles,
            report=max(len(events), 1),
            spread=self.spread,
            policy=self.search,
            rng=rng,
        )
        walked = float(weinberg(quest.events.swing).sum())
        for i in range(len(events)):
            yield search_fix(float(events.t[i]), found.beliefs[i], walked, self.policy)
        last = found.beliefs[-1]
        yield search_fix(t, last, walked, self.policy, hypotheses=True)
        if confirmed(last, walked, self.policy):
            cloud = found.cloud.thin(self.parameters.particles, float(rng.random()))
            integrity, grid = Integrity(walked_m=walked, settled=True), grids[found.level_id]
            session.track = Track(
                found.level_id, grid.features, float(quest.events.heading[-1]), cloud, last.estimate, integrity
            )
            session.quest = None
            if quest.whole:
                e, first_heading = estimate_equal(found.start, grid), float(quest.events.heading[0])
                session.beginning = Track(
                    found.level_id, grid.features, first_heading, found.start, e, Integrity(settled=True)
                )

    def _unstarted(
        self, prior: Prior, grids: Mapping[str, FilterGrid], reading: Float64Array, t: float, rng: np.random.Generator
    ) -> Fix:
        """Before the first step nothing is known but the prior."""
        level_id, grid = next(iter(grids.items()))
        cloud = initial_cloud(prior, grid, reading, self.parameters.particles, self.spread, rng)
        belief = Belief((Place(level_id, find_modes(cloud)[0]),), estimate_equal(cloud, grid))
        return search_fix(t, belief, 0.0, self.policy)

    def _advance(self, track: Track, grid: FilterGrid, events: StepEvents, i: int, rng: np.random.Generator) -> Advance:
        stride = float(weinberg(events.swing[i : i + 1])[0])
        moved = advance_cloud(
            track.cloud,
            grid,
            self.noise,
            turn_mid=float(events.motion_heading[i]) - track.heading,
            turn=float(events.heading[i]) - track.heading,
            stride=stride,
            z=channels(events.mag[i], grid.features),
            rng=rng,
        )
        track.cloud, track.estimate = moved.cloud, moved.estimate
        track.heading = float(events.heading[i])
        track.integrity = track.integrity.walked(stride, moved.estimate, self.policy)
        return moved

    def _fix(self, track: Track, t: float) -> Fix:
        verdict = judge(track.estimate, track.integrity, self.policy)
        cov_xx, cov_xy, cov_yy = calibrate(track.estimate, self.policy)
        return Fix(
            t=t,
            level_id=track.level_id,
            x=track.estimate.x,
            y=track.estimate.y,
            cov_xx=cov_xx,
            cov_xy=cov_xy,
            cov_yy=cov_yy,
            heading=track.estimate.heading,
            status=verdict.status,
            quality=verdict.quality,
            sure=verdict.sure,
            walk_on_m=verdict.walk_on_m,
        )


def first_reading(pedestrian: PedestrianState, events: StepEvents) -> tuple[float, Float64Array]:
    """Heading (free azimuth, rad) and field (forward, left, up, uT) at the first step, or now if there is none."""
    if len(events):
        return float(events.heading[0]), events.mag[0]
    return float(pedestrian.tail.heading[-1]), pedestrian.tail.mag[-10:].mean(axis=0)


def learned_calibration(cloud: Cloud) -> DeviceCalibration:
    """Moments of the particles' offsets (each with its own variance) and stride scales."""
    p = cloud.p.astype(np.float64)
    w = p[14] / p[14].sum()
    offset = p[6:9] @ w
    own = np.stack([p[12], p[12], p[13]]) @ w
    sd = np.sqrt(own + (p[6:9] - offset[:, None]) ** 2 @ w)
    scale = float(p[4] @ w)
    return DeviceCalibration(
        offset=(float(offset[0]), float(offset[1]), float(offset[2])),
        offset_sd=(float(sd[0]), float(sd[1]), float(sd[2])),
        stride_scale=scale,
        stride_scale_sd=float(np.sqrt((p[4] - scale) ** 2 @ w)),
    )


def estimate_equal(cloud: Cloud, grid: FilterGrid) -> Estimate:
    """Estimate of equally weighted particles that have not moved yet."""
    x, y = cloud.p[0].astype(np.float64), cloud.p[1].astype(np.float64)
    cov = np.cov(x, y)
    return Estimate(
        x=float(x.mean()),
        y=float(y.mean()),
        cov_xx=float(cov[0, 0]),
        cov_xy=float(cov[0, 1]),
        cov_yy=float(cov[1, 1]),
        heading=float(np.angle(np.mean(cloud.p[2] + 1j * cloud.p[3]))),
        mapped=float(grid.lookup(x, y)[:, 5].mean()),
    )
