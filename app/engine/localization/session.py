"""State of a particle tracker's session: on a quest for the place, or on a track from it."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from app.engine.calibration import SoftIron
from app.engine.filtering import Cloud, Estimate, FilterGrid
from app.engine.inertial import PedestrianState, StepEvents
from app.engine.inertial.pressure import Barometer
from app.engine.localization import codec
from app.engine.localization.aids import (
    AidMemory,
    Evaluator,
    Sighting,
    memory_from,
    memory_values,
    sighting_from,
    sighting_values,
    top,
    weigh_cloud,
)
from app.engine.localization.integrity import Integrity
from app.engine.localization.lines import OpenStep, steps_from, steps_values
from app.engine.localization.profile import profile_from, profile_values
from app.engine.localization.trail import Trail, trail_from, trail_values
from app.engine.types import DeviceCalibration, FeatureSet, Prior

_LOST = 1e-12


@dataclass(slots=True)
class Track:
    """Place known: level, heading at the last step (free azimuth, rad), particles, estimate, newest steps; and
    the device's soft iron, of which particles have none of their own."""

    level_id: str
    features: FeatureSet
    heading: float
    cloud: Cloud
    estimate: Estimate
    integrity: Integrity
    trail: Trail = field(default_factory=Trail)
    soft_iron: SoftIron = field(default_factory=lambda: SoftIron.start(None))

    def calibration(self) -> DeviceCalibration | None:
        """What the track says of the device; None if its particles' offsets are not those of three axes."""
        if self.features is not FeatureSet.VECTOR:
            return None
        iron = self.soft_iron
        return replace(learned_calibration(self.cloud), soft_iron=iron.elements, soft_iron_sd=iron.sd)


@dataclass(slots=True)
class Quest:
    """Place unknown: what is known of the start, and the steps since then (all of them if ``whole``)."""

    prior: Prior
    events: StepEvents | None = None
    whole: bool = True
    sightings: tuple[Sighting, ...] = ()


@dataclass(slots=True)
class SessionState:
    """Tracker state, decoded. ``count`` segments have been taken.

    Before the first there is neither ``pedestrian`` nor ``track`` nor ``quest``; then the session is on a quest until
    its place is known, and on a track from there, unless that is found lost (``losses`` times so far). ``open_steps``
    are those of the track that were told only in the moment, with the lines of its particles. ``beginning`` is not
    kept: it is the track's first moment, known once the quest has ended.
    """

    prior: Prior
    seed: int
    count: int = 0
    pedestrian: PedestrianState | None = None
    track: Track | None = None
    quest: Quest | None = None
    aids: AidMemory = field(default_factory=AidMemory)
    travelled_m: float = 0.0
    barometer: Barometer = field(default_factory=Barometer)
    open_steps: tuple[OpenStep, ...] = ()
    losses: int = 0
    beginning: Track | None = None

    def encode(self) -> bytes:
        """As bytes."""
        track, quest, pedestrian = self.track, self.quest, self.pedestrian
        values: dict[str, Any] = {"prior": codec.prior_values(self.prior), "seed": self.seed, "count": self.count}
        values["aids"], values["travelled_m"] = memory_values(self.aids), self.travelled_m
        values["losses"] = self.losses
        values["barometer"] = codec.barometer_values(self.barometer)
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
                "open_steps": steps_values(self.open_steps),
                "trail": trail_values(track.trail),
                "soft_iron": codec.soft_iron_values(track.soft_iron),
            }
        if quest is not None:
            events = None if quest.events is None else profile_values(quest.events)
            values["quest"] = {
                "prior": codec.prior_values(quest.prior),
                "events": events,
                "whole": quest.whole,
                "sightings": [sighting_values(s) for s in quest.sightings],
            }
        return codec.pack(values)

    @classmethod
    def decode(cls, payload: bytes) -> SessionState:
        """Inverse of :meth:`encode`; StateError if damaged."""
        values = codec.unpack(payload)
        session = cls(codec.prior_from(values["prior"]), values["seed"], values["count"])
        session.aids, session.travelled_m = memory_from(values["aids"]), values["travelled_m"]
        session.barometer, session.losses = codec.barometer_from(values["barometer"]), values["losses"]
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
                trail=trail_from(track["trail"]),
                soft_iron=codec.soft_iron_from(track["soft_iron"]),
            )
            session.open_steps = steps_from(track["open_steps"])
        if "quest" in values:
            quest = values["quest"]
            events = None if quest["events"] is None else profile_from(quest["events"])
            session.quest = Quest(codec.prior_from(quest["prior"]), events, quest["whole"])
            session.quest.sightings = tuple(sighting_from(s) for s in quest["sightings"])
        return session


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


def weigh_by(track: Track, evaluator: Evaluator, sighting: Sighting) -> float | None:
    """Let a sighting count for the particles of a track. Weights stay normalized.

    Returns
    -------
    float or None, nats
        By how much the particles explain it worse than the best place of their level; None if it tells nothing.
    """
    evidence = evaluator.evidence(sighting)
    if evidence is None:
        return None
    before = track.cloud.p[14].copy()
    weigh_cloud(track.cloud, evidence, track.level_id, log_unit=top(evidence, (track.level_id,)))
    total = float(track.cloud.p[14].sum(dtype=np.float64))
    if total > _LOST:
        track.cloud.p[14] /= np.float32(total)
    else:  # it rules all particles out: evidence or track is wrong, and it is not for one reading to say which
        track.cloud.p[14] = before
    return -float(np.log(max(total, 1e-30)))


def estimate_of(cloud: Cloud, grid: FilterGrid) -> Estimate:
    """Moments of weighted particles between two steps."""
    x, y = cloud.p[0].astype(np.float64), cloud.p[1].astype(np.float64)
    w = cloud.p[14] / cloud.p[14].sum(dtype=np.float64)
    mx, my = float(w @ x), float(w @ y)
    return Estimate(
        x=mx,
        y=my,
        cov_xx=float(w @ (x - mx) ** 2),
        cov_xy=float(w @ ((x - mx) * (y - my))),
        cov_yy=float(w @ (y - my) ** 2),
        heading=float(np.angle(np.sum(w * (cloud.p[2] + 1j * cloud.p[3]) * np.exp(-1j * cloud.p[5])))),
        mapped=float(w @ grid.lookup(x, y)[:, 5]),
    )
