"""Venues."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime
from typing import Any

from sqlalchemy import Row, delete, insert, select, update

from app.engine.geodesy import GeoBox
from app.services.records import Anchor, Found, Page, Venue, VenueKind
from app.services.search import Search
from app.storage.models import levels, venues
from app.storage.places import box_columns
from app.storage.repositories.base import expect_one
from app.storage.repositories.placed import PlacedRepository


class SqlVenueRepository(PlacedRepository):
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
                **box_columns(venue_box(venue.anchor, ())),
            )
        )
        self._set_words(venue.id, venue.name)

    def get(self, venue_id: str) -> Venue:
        """One venue."""
        return _venue(self._one("venue", venue_id, select(venues).where(venues.c.id == venue_id)))

    def list(self, *, cursor: str | None, limit: int) -> Page[Venue]:
        """Venues, newest first."""
        return self._newest_first(select(venues), venues.c.id, _venue, cursor=cursor, limit=limit)

    def find(self, search: Search, *, cursor: str | None, limit: int) -> Page[Found[Venue]]:
        """Venues of a search: nearest first where it names a place, else newest first."""
        return self._find(select(venues), venues, _venue, search, cursor=cursor, limit=limit)

    def update(self, venue_id: str, *, name: str, anchor: Anchor | None, now: datetime) -> Venue:
        """Set name and anchor; the venue and its levels are found where and as they are now."""
        before = self.get(venue_id)
        changed = self._write(
            update(venues).where(venues.c.id == venue_id).values(name=name, updated_at=now, **_anchor_columns(anchor))
        )
        expect_one(changed, "venue", venue_id)
        if name != before.name:
            self._rename(venue_id, name)
        if anchor != before.anchor:
            self._move(venue_id, anchor)
        return self.get(venue_id)

    def delete(self, venue_id: str) -> None:
        """Delete a venue without levels."""
        self._set_words(venue_id)
        expect_one(self._write(delete(venues).where(venues.c.id == venue_id)), "venue", venue_id)

    def _rename(self, venue_id: str, name: str) -> None:
        self._set_words(venue_id, name)
        for row in self._read(select(levels.c.id, levels.c.name).where(levels.c.venue_id == venue_id)).all():
            self._set_words(row.id, row.name, name)

    def _move(self, venue_id: str, anchor: Anchor | None) -> None:
        boxes = []
        for row in self._read(select(levels).where(levels.c.venue_id == venue_id)).all():
            box = level_box(anchor, (row.x_min, row.y_min, row.x_max, row.y_max))
            boxes.append(box)
            self._write(update(levels).where(levels.c.id == row.id).values(box_columns(box)))
        box = venue_box(anchor, [box for box in boxes if box is not None])
        self._write(update(venues).where(venues.c.id == venue_id).values(box_columns(box)))


def level_box(anchor: Anchor | None, extent: tuple[float, float, float, float]) -> GeoBox | None:
    """Where a level of a venue with this anchor is on earth."""
    return None if anchor is None else anchor.plane().bounds(*extent)


def venue_box(anchor: Anchor | None, boxes: Sequence[GeoBox]) -> GeoBox | None:
    """Where a venue is on earth: its anchor and its levels."""
    if anchor is None:
        return None
    whole = anchor.plane().bounds(0.0, 0.0, 0.0, 0.0)
    for box in boxes:
        whole = whole.union(box)
    return whole


def _anchor_columns(anchor: Anchor | None) -> dict[str, float | None]:
    return {
        name: None if anchor is None else getattr(anchor, name)
        for name in ("latitude_deg", "longitude_deg", "bearing_deg", "height_m")
    }


def anchor_of(row: Row[Any]) -> Anchor | None:
    """The anchor of a venue's row."""
    if row.latitude_deg is None:
        return None
    return Anchor(row.latitude_deg, row.longitude_deg, row.bearing_deg, row.height_m)


def _venue(row: Row[Any]) -> Venue:
    return Venue(
        row.id, row.name, VenueKind(row.kind), anchor_of(row), created_at=row.created_at, updated_at=row.updated_at
    )
