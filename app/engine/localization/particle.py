"""The particle tracker: pedestrian motion and a magnetic map, fused segment by segment."""

from __future__ import annotations

from collections.abc import Iterator
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
from app.engine.localization.integrity import Integrity, IntegrityPolicy, calibrate, judge
from app.engine.types import (
    DeviceCalibration,
    FeatureSet,
    Fix,
    Float64Array,
    Hypothesis,
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
        Number while it is not.
    features : FeatureSet
        ``vector`` where the map has it, else the map's own.
    """

    particles: int = 2000
    cold_particles: int = 8000
    features: FeatureSet = FeatureSet.VECTOR


@dataclass(slots=True)
class Track:
    """A session under way: steps so far, heading at the last one (free azimuth, rad), particles, estimate."""

    pedestrian: PedestrianState
    heading: float
    cloud: Cloud
    estimate: Estimate
    integrity: Integrity


@dataclass(slots=True)
class SessionState:
    """Tracker state, decoded. ``count`` segments have been taken; ``track`` is None before the first."""

    prior: Prior
    seed: int
    count: int = 0
    track: Track | None = None

    def encode(self) -> bytes:
        """As bytes."""
        track = self.track
        values: dict[str, Any] = {
            "prior": codec.prior_values(self.prior),
            "seed": self.seed,
            "count": self.count,
            "track": None,
        }
        if track is not None:
            values["track"] = {
                "pedestrian": codec.pedestrian_values(track.pedestrian),
                "heading": track.heading,
                "particles": track.cloud.p,
                "moved": track.cloud.moved,
                "estimate": asdict(track.estimate),
                "integrity": asdict(track.integrity),
            }
        return codec.pack(values)

    @classmethod
    def decode(cls, payload: bytes) -> SessionState:
        """Inverse of :meth:`encode`; StateError if damaged."""
        values = codec.unpack(payload)
        track = values["track"]
        if track is not None:
            track = Track(
                pedestrian=codec.pedestrian_state(track["pedestrian"]),
                heading=track["heading"],
                cloud=Cloud(track["particles"], track["moved"]),
                estimate=Estimate(**track["estimate"]),
                integrity=Integrity(**track["integrity"]),
            )
        return cls(codec.prior_from(values["prior"]), values["seed"], values["count"], track)


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
    ) -> None:
        self.parameters = parameters or ParticleParameters()
        self.noise = noise or ParticleNoise()
        self.spread = spread or InitialSpread()
        self.policy = policy or IntegrityPolicy()

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
        if track is None or track.integrity.cold or not track.integrity.settled:
            return None
        return learned_calibration(track.cloud)

    def walk(
        self, session: SessionState, segment: Segment, map_source: MapSource
    ) -> Iterator[tuple[Fix, Advance | None]]:
        """Advance ``session`` in place: each step's fix with what the filter did, and the fix at the end.

        The next step overwrites the particles of the one before: take what is needed before going on.
        """
        rng = np.random.default_rng([session.seed, session.count])
        level_id = map_source.level_ids()[0] if session.prior.level_id is None else session.prior.level_id
        grid = self._grid(map_source, level_id)
        before = None if session.track is None else session.track.pedestrian
        gap = 0.0 if before is None else gap_before(before, segment.samples)
        pedestrian, events = advance(before, segment.samples)
        if session.track is None:
            track = self._begin(session.prior, grid, pedestrian, events, rng)
        elif gap > FORGET_S:
            track = self._begin(Prior(session.prior.level_id), grid, pedestrian, events, rng)
        elif gap > 0.0:
            track = self._resume(session.track, gap, grid, pedestrian, events, rng)
        else:
            track = session.track
        session.track = track
        track.pedestrian = pedestrian
        for i in range(len(events)):
            moved = self._advance(track, grid, events, i, rng)
            yield self._fix(track, level_id, float(events.t[i])), moved
        yield self._last_fix(track, level_id, settled_until(segment.samples.t)), None
        session.count += 1

    def _grid(self, map_source: MapSource, level_id: str) -> FilterGrid:
        grid_map = map_source.grid_map(level_id)
        vector = grid_map.features is FeatureSet.VECTOR
        return prepare_grid(grid_map, self.parameters.features if vector else grid_map.features)

    def _begin(
        self, prior: Prior, grid: FilterGrid, pedestrian: PedestrianState, events: StepEvents, rng: np.random.Generator
    ) -> Track:
        heading, reading = first_reading(pedestrian, events)
        n = self.parameters.particles if prior.x is not None else self.parameters.cold_particles
        cloud = initial_cloud(prior, grid, reading, n, self.spread, rng)
        return Track(pedestrian, heading, cloud, estimate_equal(cloud, grid), Integrity(cold=prior.x is None))

    def _resume(
        self,
        track: Track,
        gap_s: float,
        grid: FilterGrid,
        pedestrian: PedestrianState,
        events: StepEvents,
        rng: np.random.Generator,
    ) -> Track:
        """Go on after a gap: the walker moved unseen, so the old place is only where the search begins."""
        heading, reading = first_reading(pedestrian, events)
        n = max(self.parameters.cold_particles, track.cloud.n)
        cloud = cloud_after_gap(track.cloud, gap_s, grid, reading, n, self.spread, rng)
        integrity = track.integrity.resumed(WALKING_M_S * gap_s, self.policy)
        return Track(pedestrian, heading, cloud, estimate_equal(cloud, grid), integrity)

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
        if track.cloud.n > self.parameters.particles and track.integrity.settled:
            track.cloud = track.cloud.thin(self.parameters.particles, float(rng.random()))
        return moved

    def _last_fix(self, track: Track, level_id: str, t: float) -> Fix:
        """The fix that ends a segment: with an unknown start, the heaviest of the places that fit, and the others."""
        fix = self._fix(track, level_id, t)
        if not track.integrity.cold:
            return fix
        modes = find_modes(track.cloud)
        first, e = modes[0], track.estimate
        dx, dy = e.x - first.x, e.y - first.y
        about = replace(e, cov_xx=e.cov_xx + dx * dx, cov_xy=e.cov_xy + dx * dy, cov_yy=e.cov_yy + dy * dy)
        cov_xx, cov_xy, cov_yy = calibrate(about, track.integrity, self.policy)
        places = tuple(Hypothesis(level_id, m.x, m.y, m.cov_xx, m.cov_xy, m.cov_yy, m.weight) for m in modes)
        return replace(fix, x=first.x, y=first.y, cov_xx=cov_xx, cov_xy=cov_xy, cov_yy=cov_yy, hypotheses=places)

    def _fix(self, track: Track, level_id: str, t: float) -> Fix:
        verdict = judge(track.estimate, track.integrity, self.policy)
        cov_xx, cov_xy, cov_yy = calibrate(track.estimate, track.integrity, self.policy)
        return Fix(
            t=t,
            level_id=level_id,
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


def channels(mag: Float64Array, features: FeatureSet) -> Float64Array:
    """Forward, left, up (3,) as the kernel's channels of a feature set."""
    if features is FeatureSet.VECTOR:
        return mag
    if features is FeatureSet.HV:
        return np.array([np.hypot(mag[0], mag[1]), 0.0, mag[2]])
    return np.array([0.0, 0.0, np.linalg.norm(mag)])


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
