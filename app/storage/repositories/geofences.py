"""Geofences, stays in them, and their events."""

from __future__ import annotations

from collections.abc import Sequence
from collections.abc import Set as AbstractSet
from dataclasses import asdict
from typing import Any

from sqlalchemy import BindParameter, Row, bindparam, delete, func, insert, select, true, union_all, update

from app.engine.types import FixKind, Status
from app.services.geofence_ports import Box
from app.services.geofence_records import (
    EventFilter,
    Geofence,
    GeofenceEvent,
    GeofenceEventKind,
    Stay,
    Watched,
)
from app.services.records import Page, Position
from app.storage.geofence_models import geofence_events, geofence_stays, geofences
from app.storage.models import fixes
from app.storage.repositories.base import Repository, expect_one
from app.storage.repositories.sessions import position_of

_SESSION: BindParameter[Any] = bindparam("session")
_LEVELS: BindParameter[Any] = bindparam("levels", expanding=True)
_STAY = (geofence_stays.c.session_id, geofence_stays.c.entered_t, geofence_stays.c.dwelled)
_HERE = (geofence_stays.c.geofence_id == geofences.c.id) & (geofence_stays.c.session_id == _SESSION)
_IN_REACH = (
    (geofences.c.x_min <= bindparam("x_max"))
    & (geofences.c.x_max >= bindparam("x_min"))
    & (geofences.c.y_min <= bindparam("y_max"))
    & (geofences.c.y_max >= bindparam("y_min"))
)
# built once, and one statement of two searches by index: this is asked with every segment
_WATCHED = union_all(
    select(geofences, *_STAY)
    .outerjoin(geofence_stays, _HERE)
    .where(geofences.c.level_id.in_(_LEVELS), _IN_REACH | geofence_stays.c.session_id.is_not(None)),
    select(geofences, *_STAY)
    .join(geofence_stays, geofence_stays.c.geofence_id == geofences.c.id)
    .where(geofence_stays.c.session_id == _SESSION, geofences.c.level_id.not_in(_LEVELS)),
)


class SqlGeofenceRepository(Repository):
    """Port ``GeofenceRepository``."""

    def add(self, geofence: Geofence) -> None:
        """Store a geofence."""
        self._write(insert(geofences).values(_columns(geofence)))

    def get(self, geofence_id: str) -> Geofence:
        """One geofence."""
        return _geofence(self._one("geofence", geofence_id, select(geofences).where(geofences.c.id == geofence_id)))

    def list(self, *, level_id: str | None, cursor: str | None, limit: int) -> Page[Geofence]:
        """Geofences, newest first."""
        statement = select(geofences).where(true() if level_id is None else geofences.c.level_id == level_id)
        return self._newest_first(statement, geofences.c.id, _geofence, cursor=cursor, limit=limit)

    def count(self, level_id: str) -> int:
        """How many a level has."""
        return int(self._read(select(func.count()).where(geofences.c.level_id == level_id)).scalar_one())

    def update(self, geofence: Geofence) -> None:
        """Store a geofence anew."""
        statement = update(geofences).where(geofences.c.id == geofence.id).values(_columns(geofence))
        expect_one(self._write(statement), "geofence", geofence.id)

    def delete(self, geofence_id: str) -> None:
        """Delete a geofence and the stays in it."""
        self._write(delete(geofence_stays).where(geofence_stays.c.geofence_id == geofence_id))
        expect_one(self._write(delete(geofences).where(geofences.c.id == geofence_id)), "geofence", geofence_id)

    def watched(self, session_id: str, level_ids: AbstractSet[str], box: Box) -> Sequence[Watched]:
        """Geofences of these levels that reach into the box, and all in which the session is."""
        place = dict(zip(("x_min", "y_min", "x_max", "y_max"), box, strict=True))
        rows = self._read(_WATCHED, {"session": session_id, "levels": sorted(level_ids), **place}).all()
        return sorted((_watched(row, session_id) for row in rows), key=lambda one: one.geofence.id)

    def stays(self, *, session_id: str | None = None, geofence_id: str | None = None) -> Sequence[Watched]:
        """Geofences in which a session is, or sessions that are in a geofence."""
        statement = select(geofences, *_STAY).join(geofence_stays, geofence_stays.c.geofence_id == geofences.c.id)
        for name, value in (("session_id", session_id), ("geofence_id", geofence_id)):
            if value is not None:
                statement = statement.where(geofence_stays.c[name] == value)
        rows = self._read(statement.order_by(geofence_stays.c.session_id, geofences.c.id)).all()
        return [_watched(row, row.session_id) for row in rows]

    def set_stay(self, session_id: str, geofence_id: str, before: Stay | None, stay: Stay | None) -> None:
        """Replace the session's stay in a geofence."""
        here = (geofence_stays.c.session_id == session_id) & (geofence_stays.c.geofence_id == geofence_id)
        if stay is None:
            self._write(delete(geofence_stays).where(here))
        elif before is None:
            key = {"session_id": session_id, "geofence_id": geofence_id}
            self._write(insert(geofence_stays).values(**key, **asdict(stay)))
        else:
            self._write(update(geofence_stays).where(here).values(asdict(stay)))

    def add_events(self, events: Sequence[GeofenceEvent]) -> None:
        """Store events."""
        self._write(insert(geofence_events), [asdict(event) for event in events])

    def list_events(self, wanted: EventFilter, *, cursor: str | None, limit: int) -> Page[GeofenceEvent]:
        """Events, newest first."""
        table = geofence_events
        statement = select(table)
        for name in ("geofence_id", "session_id", "level_id", "kind"):
            if (value := getattr(wanted, name)) is not None:
                statement = statement.where(table.c[name] == value)
        if wanted.after is not None:
            statement = statement.where(table.c["t"] > wanted.after.timestamp())
        if wanted.before is not None:
            statement = statement.where(table.c["t"] < wanted.before.timestamp())
        return self._newest_first(statement, table.c.id, _event, cursor=cursor, limit=limit)

    def last_claimed(self, session_id: str) -> Position | None:
        """The session's last fix that claims a position."""
        of_session = select(fixes).where(fixes.c.session_id == session_id, fixes.c.status == Status.OK)
        row = self._read(of_session.order_by(fixes.c.number.desc()).limit(1)).one_or_none()
        return None if row is None else position_of(row, FixKind.FILTERED)


def _columns(geofence: Geofence) -> dict[str, Any]:
    x, y = zip(*geofence.polygon, strict=True)
    return asdict(geofence) | {
        "polygon": [list(point) for point in geofence.polygon],
        "events": sorted(geofence.events),
        "x_min": min(x),
        "y_min": min(y),
        "x_max": max(x),
        "y_max": max(y),
    }


def _geofence(row: Row[Any]) -> Geofence:
    return Geofence(
        id=row.id,
        level_id=row.level_id,
        name=row.name,
        polygon=tuple((x, y) for x, y in row.polygon),
        events=frozenset(map(GeofenceEventKind, row.events)),
        dwell_s=row.dwell_s,
        confidence=row.confidence,
        created_at=row.created_at,
        updated_at=row.updated_at,
    )


def _watched(row: Row[Any], session_id: str) -> Watched:
    stay = None if row.session_id is None else Stay(row.entered_t, row.dwelled)
    return Watched(_geofence(row), session_id, stay)


def _event(row: Row[Any]) -> GeofenceEvent:
    values = dict(row._mapping)
    return GeofenceEvent(**values | {"kind": GeofenceEventKind(values["kind"])})
