"""What the use cases of geofences need from storage."""

from __future__ import annotations

from collections.abc import Sequence
from collections.abc import Set as AbstractSet
from typing import Protocol

from app.services.geofence_records import EventFilter, Geofence, GeofenceEvent, Stay, Watched
from app.services.records import Page, Position

Box = tuple[float, float, float, float]
"""``(x_min, y_min, x_max, y_max)`` in the level frame, m."""


class GeofenceRepository(Protocol):
    """Geofences, the sessions inside them, and what happened at them."""

    def add(self, geofence: Geofence) -> None:
        """Store a geofence."""
        ...

    def get(self, geofence_id: str) -> Geofence:
        """One geofence."""
        ...

    def list(self, *, level_id: str | None, cursor: str | None, limit: int) -> Page[Geofence]:
        """Geofences, newest first."""
        ...

    def count(self, level_id: str) -> int:
        """How many a level has."""
        ...

    def update(self, geofence: Geofence) -> None:
        """Store a geofence anew, in place of the one with its id."""
        ...

    def delete(self, geofence_id: str) -> None:
        """Delete a geofence and the stays in it; its events are kept."""
        ...

    def watched(self, session_id: str, level_ids: AbstractSet[str], box: Box) -> Sequence[Watched]:
        """Geofences of these levels that reach into the box, and all in which the session is; one statement."""
        ...

    def stays(self, *, session_id: str | None = None, geofence_id: str | None = None) -> Sequence[Watched]:
        """Geofences in which a session is, or sessions that are in a geofence."""
        ...

    def set_stay(self, session_id: str, geofence_id: str, before: Stay | None, stay: Stay | None) -> None:
        """Replace the session's stay in a geofence; None: it is not inside."""
        ...

    def add_events(self, events: Sequence[GeofenceEvent]) -> None:
        """Store events."""
        ...

    def list_events(self, wanted: EventFilter, *, cursor: str | None, limit: int) -> Page[GeofenceEvent]:
        """Events, newest first."""
        ...

    def last_claimed(self, session_id: str) -> Position | None:
        """The session's last fix that claims a position."""
        ...
