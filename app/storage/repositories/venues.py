"""Venues."""

from __future__ import annotations

from datetime import datetime
from typing import Any

from sqlalchemy import Row, delete, insert, select, update

from app.services.records import Anchor, Page, Venue, VenueKind
from app.storage.models import venues
from app.storage.repositories.base import Repository, expect_one


class SqlVenueRepository(Repository):
    """Port ``VenueRepository``."""

    def add(self, venue: Venue) -> None:
        """Store a venue."""
        self._write(
            insert(venues).values(
                id=venue.id,
                name=venue.name,
                kind=venue.kind,
                created_at=venue.created_at,
                updated_at=venue.updated_at,
                **_anchor_columns(venue.anchor),
            )
        )

    def get(self, venue_id: str) -> Venue:
        """One venue."""
        return _venue(self._one("venue", venue_id, select(venues).where(venues.c.id == venue_id)))

    def list(self, *, cursor: str | None, limit: int) -> Page[Venue]:
        """Venues, newest first."""
        return self._newest_first(select(venues), venues.c.id, _venue, cursor=cursor, limit=limit)

    def update(self, venue_id: str, *, name: str, anchor: Anchor | None, now: datetime) -> Venue:
        """Set name and anchor."""
        changed = self._write(
            update(venues).where(venues.c.id == venue_id).values(name=name, updated_at=now, **_anchor_columns(anchor))
        )
        expect_one(changed, "venue", venue_id)
        return self.get(venue_id)

    def delete(self, venue_id: str) -> None:
        """Delete a venue without levels."""
        expect_one(self._write(delete(venues).where(venues.c.id == venue_id)), "venue", venue_id)


def _anchor_columns(anchor: Anchor | None) -> dict[str, float | None]:
    return {
        name: None if anchor is None else getattr(anchor, name)
        for name in ("latitude_deg", "longitude_deg", "bearing_deg", "height_m")
    }


def _venue(row: Row[Any]) -> Venue:
    anchor = None
    if row.latitude_deg is not None:
        anchor = Anchor(row.latitude_deg, row.longitude_deg, row.bearing_deg, row.height_m)
    return Venue(row.id, row.name, VenueKind(row.kind), anchor, created_at=row.created_at, updated_at=row.updated_at)
