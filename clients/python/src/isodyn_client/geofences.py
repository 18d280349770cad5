"""Geofences and their events: models, and the calls of the API."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from datetime import datetime
from enum import StrEnum
from typing import Any

from isodyn_client.calls import Call, Listing, as_bytes, as_model, fresh_idempotency_key, nothing, present
from isodyn_client.encoding import json_body
from isodyn_client.models import Model, Page

_PATH = "/v1/geofences"
_EVENTS = "/v1/geofence-events"
_PAGE = 100


class GeofenceEventKind(StrEnum):
    """What happened to a session at a geofence."""

    ENTER = "enter"
    LEAVE = "leave"
    DWELL = "dwell"


class Geofence(Model):
    """An area of a level whose crossings are told; ``polygon`` in level metres, counter-clockwise, not closed."""

    id: str
    name: str
    level_id: str
    polygon: tuple[tuple[float, float], ...]
    events: tuple[GeofenceEventKind, ...]
    dwell_s: float | None = None
    confidence: float
    created_at: datetime
    updated_at: datetime


class GeofenceEvent(Model):
    """A session entered, left or dwelt in a geofence.

    ``t_ms`` is the time of the fix that showed it, ``probability`` how likely that fix was inside, ``dwell_s`` how long
    the stay had lasted, ``reason`` why a stay ended without a fix outside.
    """

    id: str
    kind: GeofenceEventKind
    geofence_id: str
    geofence_name: str
    session_id: str
    device_id: str | None = None
    venue_id: str
    level_id: str
    seq: int | None = None
    t_ms: float
    x: float | None = None
    y: float | None = None
    probability: float | None = None
    dwell_s: float | None = None
    reason: str | None = None
    created_at: datetime


def create_geofence(
    level_id: str,
    name: str,
    polygon: Sequence[Sequence[float]],
    *,
    events: Iterable[GeofenceEventKind | str] | None = None,
    dwell_s: float | None = None,
    confidence: float | None = None,
) -> Call[Geofence]:
    """Draw an area on a level: corners ``(x, y)`` of a simple polygon in level metres.

    ``events`` are those that are told (``enter`` and ``leave`` unless others are named; ``dwell`` needs ``dwell_s``). A
    session enters when a fix is inside with the probability ``confidence`` (0.9), and leaves at one minus that.
    """
    fields = _fields(name=name, polygon=polygon, events=events, dwell_s=dwell_s, confidence=confidence)
    body = json_body({"level_id": level_id, **fields})
    return Call("POST", _PATH, as_model(Geofence), headers=fresh_idempotency_key(), body=body)


def geofence(geofence_id: str) -> Call[Geofence]:
    """One geofence."""
    return Call("GET", f"{_PATH}/{geofence_id}", as_model(Geofence))


def geofences(*, level_id: str | None = None) -> Listing[Geofence]:
    """All geofences (of one level), newest first."""
    return Listing(Call("GET", _PATH, as_model(Page[Geofence]), params=present({"level_id": level_id, "limit": _PAGE})))


def update_geofence(
    geofence_id: str,
    *,
    name: str | None = None,
    polygon: Sequence[Sequence[float]] | None = None,
    events: Iterable[GeofenceEventKind | str] | None = None,
    dwell_s: float | None = None,
    confidence: float | None = None,
) -> Call[Geofence]:
    """Change a geofence; what is None stays as it is."""
    fields = _fields(name=name, polygon=polygon, events=events, dwell_s=dwell_s, confidence=confidence)
    return Call("PATCH", f"{_PATH}/{geofence_id}", as_model(Geofence), body=json_body(fields))


def delete_geofence(geofence_id: str) -> Call[None]:
    """Delete a geofence: sessions inside leave it. Its events are kept."""
    return Call("DELETE", f"{_PATH}/{geofence_id}", nothing)


def geofence_events(
    *,
    geofence_id: str | None = None,
    session_id: str | None = None,
    level_id: str | None = None,
    kind: GeofenceEventKind | str | None = None,
    after: datetime | None = None,
    before: datetime | None = None,
) -> Listing[GeofenceEvent]:
    """Who entered, left or dwelt in geofences, newest first; times are those of the fixes."""
    params = _wanted(geofence_id, session_id, level_id, kind, after, before) | {"limit": _PAGE}
    return Listing(Call("GET", _EVENTS, as_model(Page[GeofenceEvent]), params=params))


def geofence_events_csv(
    *,
    geofence_id: str | None = None,
    session_id: str | None = None,
    level_id: str | None = None,
    kind: GeofenceEventKind | str | None = None,
    after: datetime | None = None,
    before: datetime | None = None,
) -> Call[bytes]:
    """The newest 500 of these events as a table (CSV)."""
    params = _wanted(geofence_id, session_id, level_id, kind, after, before) | {"limit": 500}
    return Call("GET", _EVENTS, as_bytes, params=params, headers={"Accept": "text/csv"})


def _fields(
    *,
    name: str | None,
    polygon: Sequence[Sequence[float]] | None,
    events: Iterable[GeofenceEventKind | str] | None,
    dwell_s: float | None,
    confidence: float | None,
) -> dict[str, Any]:
    return present(
        {
            "name": name,
            "polygon": None if polygon is None else [[float(x), float(y)] for x, y in polygon],
            "events": None if events is None else [str(event) for event in events],
            "dwell_s": dwell_s,
            "confidence": confidence,
        }
    )


def _wanted(
    geofence_id: str | None,
    session_id: str | None,
    level_id: str | None,
    kind: GeofenceEventKind | str | None,
    after: datetime | None,
    before: datetime | None,
) -> dict[str, Any]:
    return present(
        {
            "geofence_id": geofence_id,
            "session_id": session_id,
            "level_id": level_id,
            "kind": None if kind is None else str(kind),
            "after": after and after.isoformat(),
            "before": before and before.isoformat(),
        }
    )
