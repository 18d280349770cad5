"""What a segment brings beside the field, as evidence about position: radio scans and satellite fixes.

A piece of evidence is kept as it was measured and turned into log weights for the levels it is asked about, so that a
search can go through a walk again with all of its evidence.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from app.engine.filtering import Cloud
from app.engine.localization.radio import RadioAid, RadioField, RadioMemory, RadioScan
from app.engine.types import Float64Array, MapSource, Segment

GNSS_FLOOR_M = 3.0
"""Standard deviation per axis that no satellite fix beside buildings is trusted below."""
GNSS_RENEWAL_S = 10.0
"""Errors of satellite fixes are alike over this time (multipath), so a fix soon after another counts less."""
_DEGREES_OF_FREEDOM = 3.0


@dataclass(frozen=True, slots=True)
class GnssSighting:
    """One satellite fix: time (s), position (m), standard deviation per axis (m), and what it still counts."""

    t: float
    x: float
    y: float
    sd: float
    share: float

    def log_weights(self, level_id: str, x: Float64Array, y: Float64Array) -> Float64Array:  # noqa: ARG002 - any level
        """Student t about the fix: reflections put some fixes far off."""
        q = ((x - self.x) ** 2 + (y - self.y) ** 2) / (self.sd**2 + GNSS_FLOOR_M**2)
        half = 0.5 * (_DEGREES_OF_FREEDOM + 2.0)
        return np.asarray(-self.share * half * np.log1p(q / _DEGREES_OF_FREEDOM))


@dataclass(frozen=True, slots=True)
class RadioSighting:
    """One scan, and how far into the session it was taken, m."""

    scan: RadioScan
    travelled_m: float

    @property
    def t(self) -> float:
        """Mean time of its readings, s."""
        return self.scan.t


@dataclass(frozen=True, slots=True)
class LevelSighting:
    """What is known of one level against all others: time (s), level, log odds."""

    t: float
    level_id: str
    log: float

    def log_weights(self, level_id: str, x: Float64Array, y: Float64Array) -> Float64Array:  # noqa: ARG002 - any place
        """The same all over a level."""
        return np.full(x.shape, self.log if level_id == self.level_id else 0.0)


Sighting = GnssSighting | RadioSighting | LevelSighting
Evidence = GnssSighting | RadioField | LevelSighting
"""A sighting that can be asked for log weights."""


@dataclass(frozen=True, slots=True)
class AidMemory:
    """What a session keeps of its aids: the radio's account, and the time of the last satellite fix, s."""

    radio: RadioMemory = field(default_factory=RadioMemory)
    gnss_t: float = -np.inf


def sightings(segment: Segment, memory: AidMemory, travelled_m: float) -> tuple[AidMemory, tuple[Sighting, ...]]:
    """New evidence of a segment in time order; what was seen before is left out.

    Parameters
    ----------
    travelled_m : float, m
        Way of the session before this segment; a scan's own way is filled in by :func:`at_way`.
    """
    radio = memory.radio
    scans = RadioAid({}).scans(radio, segment.wifi, segment.ble)
    if scans:
        radio = replace(radio, last_t=scans[-1].newest_t)
    found: list[Sighting] = [RadioSighting(scan, travelled_m) for scan in scans]
    last = memory.gnss_t
    if segment.gnss is not None:
        g = segment.gnss
        for t, x, y, sd in zip(g.t.tolist(), g.x.tolist(), g.y.tolist(), g.sd.tolist(), strict=True):
            if t > last:
                share = 1.0 - float(np.exp(-(t - last) / GNSS_RENEWAL_S))
                found.append(GnssSighting(t, x, y, sd, share))
                last = t
    found.sort(key=lambda sighting: sighting.t)
    return AidMemory(radio, last), tuple(found)


def at_way(found: Sequence[Sighting], t: Float64Array, way: Float64Array) -> tuple[Sighting, ...]:
    """Scans with the way walked when they were taken.

    ``way`` (k + 1,) m is that before the first step and after each of the steps at ``t`` (k,) s.
    """
    return tuple(
        replace(s, travelled_m=float(way[np.searchsorted(t, s.t)])) if isinstance(s, RadioSighting) else s
        for s in found
    )


class Evaluator:
    """Turns sightings into evidence on some levels; scans must come in order, as each counts what is new in it."""

    def __init__(self, map_source: MapSource, level_ids: Sequence[str], memory: RadioMemory | None = None) -> None:
        maps = {level_id: map_source.grid_map(level_id).radio for level_id in level_ids}
        self._aid = RadioAid({level_id: radio for level_id, radio in maps.items() if radio is not None})
        self.memory = memory or RadioMemory()

    def evidence(self, sighting: Sighting) -> Evidence | None:
        """Log weights of a sighting, None if it tells nothing."""
        if isinstance(sighting, GnssSighting | LevelSighting):
            return sighting
        if not self._aid.maps:
            return None
        self.memory, found = self._aid.field(self.memory, sighting.scan, sighting.travelled_m)
        return found


def weigh_cloud(cloud: Cloud, evidence: Evidence, level_id: str, *, log_unit: float = 0.0) -> None:
    """Multiply the particles' weights by the evidence; ``log_unit`` is subtracted (the same for all levels)."""
    log = evidence.log_weights(level_id, cloud.p[0].astype(np.float64), cloud.p[1].astype(np.float64))
    cloud.p[14] *= np.exp(log - log_unit).astype(np.float32)


def top(evidence: Evidence, level_ids: Sequence[str]) -> float:
    """The most that the evidence gives any place on these levels."""
    if isinstance(evidence, GnssSighting | LevelSighting):
        return 0.0
    return max((float(evidence.log[level_id].max()) for level_id in level_ids if level_id in evidence.log), default=0.0)


def memory_values(memory: AidMemory) -> dict[str, Any]:
    """As plain values."""
    radio = memory.radio
    return {
        "last_t": radio.last_t,
        "wifi_travelled_m": radio.wifi_travelled_m,
        "ble_travelled_m": radio.ble_travelled_m,
        "gnss_t": memory.gnss_t,
    }


def memory_from(values: Mapping[str, Any]) -> AidMemory:
    """Inverse of :func:`memory_values`."""
    radio = RadioMemory(values["last_t"], values["wifi_travelled_m"], values["ble_travelled_m"])
    return AidMemory(radio, values["gnss_t"])


def sighting_values(sighting: Sighting) -> list[Any]:
    """As plain values."""
    if isinstance(sighting, GnssSighting):
        return ["gnss", sighting.t, sighting.x, sighting.y, sighting.sd, sighting.share]
    if isinstance(sighting, LevelSighting):
        return ["level", sighting.t, sighting.level_id, sighting.log]
    scan = sighting.scan
    return ["radio", scan.t, scan.newest_t, list(scan.name), scan.rssi, sighting.travelled_m]


def sighting_from(values: Sequence[Any]) -> Sighting:
    """Inverse of :func:`sighting_values`."""
    kind, *rest = values
    if kind == "gnss":
        return GnssSighting(*rest)
    if kind == "level":
        return LevelSighting(*rest)
    t, newest_t, name, rssi, travelled_m = rest
    return RadioSighting(RadioScan(t, newest_t, tuple(name), rssi), travelled_m)
