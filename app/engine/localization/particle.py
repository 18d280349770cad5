"""The particle tracker: pedestrian motion and a magnetic map, fused segment by segment."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from app.engine.errors import StateError
from app.engine.filtering import Cloud, Estimate, FilterGrid, ParticleNoise, advance_cloud, prepare_grid
from app.engine.inertial import PedestrianState, StepEvents, advance
from app.engine.inertial.stride import weinberg
from app.engine.localization import codec
from app.engine.localization.initial import InitialSpread, initial_cloud
from app.engine.localization.integrity import Integrity, IntegrityPolicy, judge
from app.engine.types import FeatureSet, Fix, Float64Array, MapSource, Prior, Segment, TrackerState


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
class _State:
    """Tracker state, decoded."""

    prior: Prior
    seed: int
    count: int = 0
    pedestrian: PedestrianState | None = None
    heading: float = 0.0
    cloud: Cloud | None = None
    estimate: Estimate | None = None
    integrity: Integrity = field(default_factory=Integrity)

    def values(self) -> dict[str, Any]:
        """Plain values for the codec."""
        e = self.estimate
        return {
            "prior": codec.prior_values(self.prior), "seed": self.seed, "count": self.count,
            "pedestrian": codec.pedestrian_values(self.pedestrian), "heading": self.heading,
            "cloud": None if self.cloud is None else self.cloud.p,
            "moved": self.cloud is not None and self.cloud.moved,
            "estimate": None if e is None else
            [e.x, e.y, e.cov_xx, e.cov_xy, e.cov_yy, e.heading, e.mapped, e.effective],
            "integrity": [self.integrity.walked_m, self.integrity.mapped, self.integrity.settled],
        }  # fmt: skip

    @classmethod
    def of(cls, values: dict[str, Any]) -> _State:
        """Inverse of :meth:`values`."""
        cloud = None if values["cloud"] is None else Cloud(values["cloud"], values["moved"])
        estimate = None if values["estimate"] is None else Estimate(*values["estimate"])
        return cls(
            Prior(**values["prior"]), values["seed"], values["count"],
            codec.pedestrian_state(values["pedestrian"]), values["heading"], cloud, estimate,
            Integrity(*values["integrity"]),
        )  # fmt: skip


class ParticleTracker:
    """Bias-aware, map-constrained particle filter over the steps of a pedestrian.

    Follows MaLoc's idea (Xie et al., 2014, doi:10.1145/2632048.2632057: particles of position and heading weighted by the
    field), and differs in that the sensor's offset is marginalized, residuals are whitened along the path, and the map's own
    standard deviation enters the weight, so that unmapped ground costs nothing and gains nothing.
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
        return TrackerState(self.method, codec.pack(_State(prior, seed).values()))

    def step(
        self, state: TrackerState, segment: Segment, map_source: MapSource
    ) -> tuple[TrackerState, tuple[Fix, ...]]:
        """Advance by one segment: a fix per confirmed step, and one at the segment's end."""
        if state.method != self.method:
            raise StateError(f"state belongs to method {state.method!r}, not {self.method!r}")
        s = _State.of(codec.unpack(state.payload))
        rng = np.random.default_rng([s.seed, s.count])
        grid_map = map_source.grid_map(s.prior.level_id)
        features = self.parameters.features if grid_map.features is FeatureSet.VECTOR else grid_map.features
        grid = prepare_grid(grid_map, features)
        s.pedestrian, events = advance(s.pedestrian, segment.samples)
        if s.cloud is None:
            self._begin(s, grid, events, rng)
        fixes = [self._walk(s, grid, events, i, rng) for i in range(len(events))]
        last_t = float(segment.samples.t[-1])
        fixes.append(self._fix(s, last_t))
        s.count += 1
        return TrackerState(self.method, codec.pack(s.values()), last_t), tuple(fixes)

    def _begin(self, s: _State, grid: FilterGrid, events: StepEvents, rng: np.random.Generator) -> None:
        assert s.pedestrian is not None  # set by the caller
        tail = s.pedestrian.tail
        s.heading = float(events.heading[0]) if len(events) else float(tail.heading[-1])
        first = events.mag[0] if len(events) else tail.mag[-10:].mean(axis=0)
        n = self.parameters.particles if s.prior.x is not None else self.parameters.cold_particles
        s.cloud = initial_cloud(s.prior, grid, first, n, self.spread, rng)
        s.estimate = _moments(s.cloud, grid)

    def _walk(self, s: _State, grid: FilterGrid, events: StepEvents, i: int, rng: np.random.Generator) -> Fix:
        assert s.cloud is not None  # set by _begin
        stride = float(weinberg(events.swing[i : i + 1])[0])
        s.cloud, s.estimate = advance_cloud(
            s.cloud,
            grid,
            self.noise,
            turn_mid=float(events.motion_heading[i]) - s.heading,
            turn=float(events.heading[i]) - s.heading,
            stride=stride,
            z=channels(events.mag[i], grid.features),
            rng=rng,
        )
        s.heading = float(events.heading[i])
        s.integrity = s.integrity.walked(stride, s.estimate, self.policy)
        if s.cloud.n > self.parameters.particles and s.integrity.settled:
            s.cloud = s.cloud.thin(self.parameters.particles, float(rng.random()))
        return self._fix(s, float(events.t[i]))

    def _fix(self, s: _State, t: float) -> Fix:
        assert s.estimate is not None  # set by _begin
        e = s.estimate
        verdict = judge(e, s.integrity, self.policy)
        scale, floor = self.policy.covariance_scale, self.policy.covariance_floor
        return Fix(
            t=t, level_id=s.prior.level_id, x=e.x, y=e.y,
            cov_xx=scale * e.cov_xx + floor, cov_xy=scale * e.cov_xy, cov_yy=scale * e.cov_yy + floor,
            heading=e.heading, status=verdict.status, quality=verdict.quality, sure=verdict.sure,
            walk_on_m=verdict.walk_on_m,
        )  # fmt: skip


def channels(mag: Float64Array, features: FeatureSet) -> Float64Array:
    """Forward, left, up (3,) as the kernel's channels of a feature set."""
    if features is FeatureSet.VECTOR:
        return mag
    if features is FeatureSet.HV:
        return np.array([np.hypot(mag[0], mag[1]), 0.0, mag[2]])
    return np.array([0.0, 0.0, np.linalg.norm(mag)])


def _moments(cloud: Cloud, grid: FilterGrid) -> Estimate:
    """Estimate of equally weighted particles."""
    x, y = cloud.p[0].astype(np.float64), cloud.p[1].astype(np.float64)
    cov = np.cov(x, y)
    heading = float(np.angle(np.mean(cloud.p[2] + 1j * cloud.p[3])))
    mapped = float(grid.lookup(x, y)[:, 5].mean())
    return replace(
        Estimate(float(x.mean()), float(y.mean()), 0.0, 0.0, 0.0, heading, mapped, 1.0),
        cov_xx=float(cov[0, 0]), cov_xy=float(cov[0, 1]), cov_yy=float(cov[1, 1]),
    )  # fmt: skip
