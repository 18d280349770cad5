"""Records of geofences: the areas themselves, who is in them, and what happened."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from enum import StrEnum

Polygon = tuple[tuple[float, float], ...]
"""Vertices ``(x, y)`` in level metres, counter-clockwise, not closed."""


class GeofenceEventKind(StrEnum):
    """What happened to a session at a geofence."""

    ENTER = "enter"
    LEAVE = "leave"
    DWELL = "dwell"


@dataclass(frozen=True, slots=True)
class Geofence:
    """An area of a level whose crossings are told.

    Attributes
    ----------
    events : frozenset of GeofenceEventKind
        Those that are told; who is inside is known whatever they are.
    dwell_s : float or None, s
        How long a stay must last to be told as ``dwell``.
    confidence : float
        Probability of being inside from which on a session has entered; it has left at one minus this or less.
    """

    id: str
    level_id: str
    name: str
    polygon: Polygon
    events: frozenset[GeofenceEventKind]
    dwell_s: float | None
    confidence: float
    created_at: datetime
    updated_at: datetime


@dataclass(frozen=True, slots=True)
class Stay:
    """A session inside a geofence since the fix of ``entered_t`` (UTC s); ``dwelled``: told as a dwell already."""

    entered_t: float
    dwelled: bool = False


@dataclass(frozen=True, slots=True)
class Watched:
    """A geofence that a session may have crossed, and its stay there, if it is inside."""

    geofence: Geofence
    session_id: str
    stay: Stay | None


@dataclass(frozen=True, slots=True)
class GeofenceEvent:
    """A session entered, left or dwelt in a geofence.

    Attributes
    ----------
    level_id : str
        The geofence's.
    t : float, s
        UTC seconds: time of the fix that showed it.
    seq : int or None
        Segment of that fix.
    x, y : float or None, m
        Where it was; None if that was on another level, or nowhere.
    probability : float or None
        That it was inside.
    dwell_s : float or None, s
        How long the stay had lasted.
    reason : str or None
        Why a stay ended without a fix outside: ``another level``, ``session closed``, ``geofence deleted``.
    """

    id: str
    kind: GeofenceEventKind
    geofence_id: str
    geofence_name: str
    session_id: str
    device_id: str | None
    venue_id: str
    level_id: str
    seq: int | None
    t: float
    x: float | None
    y: float | None
    probability: float | None
    dwell_s: float | None
    reason: str | None
    created_at: datetime


@dataclass(frozen=True, slots=True)
class EventFilter:
    """Which events are wanted; ``after`` and ``before`` are about the time of the fix."""

    geofence_id: str | None = None
    session_id: str | None = None
    level_id: str | None = None
    kind: GeofenceEventKind | None = None
    after: datetime | None = None
    before: datetime | None = None
