"""Geofences: areas of levels, and what happened at them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime

import numpy as np

from app.engine.errors import InputError
from app.engine.geofencing import simple_ring
from app.services.base import DEFAULT_LIMIT, Service, check_limit
from app.services.errors import ConflictError, InvalidError
from app.services.geofence_records import EventFilter, Geofence, GeofenceEvent, GeofenceEventKind, Polygon
from app.services.geofencing import GEOFENCE_DELETED, end_stays
from app.services.ids import new_id
from app.services.records import Level, Page

MAX_PER_LEVEL = 1000
NEAR_M = 50.0
"""How far outside the level's extent a vertex may lie: doors and pavements do."""
DEFAULT_CONFIDENCE = 0.9
MIN_CONFIDENCE, MAX_CONFIDENCE = 0.55, 0.999
MAX_DWELL_S = 7 * 86_400.0
DEFAULT_EVENTS = frozenset({GeofenceEventKind.ENTER, GeofenceEventKind.LEAVE})


@dataclass(frozen=True, slots=True)
class GeofenceSpec:
    """What a geofence is to be."""

    name: str
    polygon: Sequence[Sequence[float]]
    events: frozenset[GeofenceEventKind] = DEFAULT_EVENTS
    dwell_s: float | None = None
    confidence: float = DEFAULT_CONFIDENCE


class GeofenceService(Service):
    """Create, change and delete geofences; read their events."""

    def create(self, level_id: str, spec: GeofenceSpec) -> Geofence:
        """Create a geofence. Sessions that are inside already enter it with their next fix."""
        now = self._clock()
        with self._uow(write=True) as uow:
            level = uow.levels.get(level_id)
            if uow.geofences.count(level_id) >= MAX_PER_LEVEL:
                raise ConflictError(f"level {level_id} has {MAX_PER_LEVEL} geofences already; delete one first")
            geofence = _checked(new_id("gfc", now), level, spec, created_at=now, now=now)
            uow.geofences.add(geofence)
        return geofence

    def get(self, geofence_id: str) -> Geofence:
        """One geofence."""
        with self._uow() as uow:
            return uow.geofences.get(geofence_id)

    def list(
        self, level_id: str | None = None, cursor: str | None = None, limit: int = DEFAULT_LIMIT
    ) -> Page[Geofence]:
        """Geofences, newest first, of one level if it is named."""
        with self._uow() as uow:
            if level_id is not None:
                uow.levels.get(level_id)
            return uow.geofences.list(level_id=level_id, cursor=cursor, limit=check_limit(limit))

    def update(self, geofence_id: str, spec: GeofenceSpec) -> Geofence:
        """Make a geofence what is given. Who is inside stays so until a fix says otherwise."""
        now = self._clock()
        with self._uow(write=True) as uow:
            known = uow.geofences.get(geofence_id)
            level = uow.levels.get(known.level_id)
            geofence = _checked(known.id, level, spec, created_at=known.created_at, now=now)
            uow.geofences.update(geofence)
        return geofence

    def delete(self, geofence_id: str) -> None:
        """Delete a geofence: whoever is inside leaves it. Its events are kept."""
        now = self._clock()
        with self._uow(write=True) as uow:
            uow.geofences.get(geofence_id)
            end_stays(uow, uow.geofences.stays(geofence_id=geofence_id), GEOFENCE_DELETED, now)
            uow.geofences.delete(geofence_id)

    def events(self, wanted: EventFilter, cursor: str | None = None, limit: int = DEFAULT_LIMIT) -> Page[GeofenceEvent]:
        """Events, newest first."""
        with self._uow() as uow:
            return uow.geofences.list_events(wanted, cursor=cursor, limit=check_limit(limit))


def _checked(id_: str, level: Level, spec: GeofenceSpec, *, created_at: datetime, now: datetime) -> Geofence:
    if not MIN_CONFIDENCE <= spec.confidence <= MAX_CONFIDENCE:
        remedy = f"give {MIN_CONFIDENCE} to {MAX_CONFIDENCE}: less would enter and leave by chance"
        raise InvalidError("confidence", f"{spec.confidence:g} is out of range", remedy)
    if not spec.events:
        raise InvalidError("events", "is empty", "name at least one of enter, leave, dwell")
    return Geofence(
        id=id_,
        level_id=level.id,
        name=spec.name,
        polygon=_polygon(level, spec.polygon),
        events=spec.events,
        dwell_s=_dwell(spec),
        confidence=spec.confidence,
        created_at=created_at,
        updated_at=now,
    )


def _dwell(spec: GeofenceSpec) -> float | None:
    if (GeofenceEventKind.DWELL in spec.events) != (spec.dwell_s is not None):
        raise InvalidError("dwell_s", "and the event dwell need one another", "send both, or neither")
    if spec.dwell_s is not None and not 0.0 < spec.dwell_s <= MAX_DWELL_S:
        raise InvalidError("dwell_s", f"{spec.dwell_s:g} is out of range", f"give more than 0 to {MAX_DWELL_S:g} s")
    return spec.dwell_s


def _polygon(level: Level, points: Sequence[Sequence[float]]) -> Polygon:
    try:
        ring = simple_ring("polygon", np.array(points, dtype=np.float64))
    except InputError as error:
        remedy = "send the corners of one simple polygon in order, [[x, y], ...] in level metres"
        raise InvalidError(error.field, error.message, remedy) from error
    x_min, y_min, x_max, y_max = level.extent
    for x, y in ring:
        if not (x_min - NEAR_M <= x <= x_max + NEAR_M and y_min - NEAR_M <= y <= y_max + NEAR_M):
            message = f"({x:g}, {y:g}) is more than {NEAR_M:g} m outside the level"
            remedy = f"stay near its extent: x {x_min:g} to {x_max:g}, y {y_min:g} to {y_max:g}"
            raise InvalidError("polygon", message, remedy)
    return tuple((float(x), float(y)) for x, y in ring)
