"""Venues and their levels."""

from __future__ import annotations

import json
import math

from app.engine.errors import InputError
from app.engine.mapping import FloorPlan
from app.services.base import DEFAULT_LIMIT, Service, check_limit
from app.services.errors import ConflictError, InvalidError, NotFoundError
from app.services.ids import new_id
from app.services.records import Anchor, Level, Page, Venue, VenueKind


class VenueService(Service):
    """Create and read venues, levels and their plans."""

    def create(self, name: str, kind: VenueKind, anchor: Anchor | None = None) -> Venue:
        """Create a venue."""
        now = self._clock()
        venue = Venue(new_id("ven", now), name, kind, anchor, created_at=now, updated_at=now)
        with self._uow(write=True) as uow:
            uow.venues.add(venue)
        return venue

    def get(self, venue_id: str) -> Venue:
        """One venue."""
        with self._uow() as uow:
            return uow.venues.get(venue_id)

    def list(self, cursor: str | None = None, limit: int = DEFAULT_LIMIT) -> Page[Venue]:
        """Venues, newest first."""
        with self._uow() as uow:
            return uow.venues.list(cursor=cursor, limit=check_limit(limit))

    def update(self, venue_id: str, name: str, anchor: Anchor | None) -> Venue:
        """Set name and anchor."""
        with self._uow(write=True) as uow:
            return uow.venues.update(venue_id, name=name, anchor=anchor, now=self._clock())

    def delete(self, venue_id: str) -> None:
        """Delete a venue that has no levels."""
        with self._uow(write=True) as uow:
            uow.venues.get(venue_id)
            if uow.levels.list(venue_id=venue_id, cursor=None, limit=1).items:
                raise ConflictError(f"venue {venue_id} has levels; only an empty venue can be deleted")
            uow.venues.delete(venue_id)

    def create_level(self, venue_id: str, name: str, ordinal: int, extent: tuple[float, float, float, float]) -> Level:
        """Create a level; ``extent`` is ``(x_min, y_min, x_max, y_max)`` in metres."""
        _check_extent(extent)
        now = self._clock()
        level = Level(
            id=new_id("lvl", now),
            venue_id=venue_id,
            name=name,
            ordinal=ordinal,
            extent=extent,
            has_plan_image=False,
            has_vector_plan=False,
            current_map_id=None,
            created_at=now,
            updated_at=now,
        )
        with self._uow(write=True) as uow:
            uow.venues.get(venue_id)
            uow.levels.add(level)
        return level

    def update_level(self, level_id: str, name: str, ordinal: int, extent: tuple[float, float, float, float]) -> Level:
        """Set name, storey and extent (metres). Maps and walks stay as they are; a plan image covers the new extent."""
        _check_extent(extent)
        with self._uow(write=True) as uow:
            return uow.levels.update(level_id, name=name, ordinal=ordinal, extent=extent, now=self._clock())

    def get_level(self, level_id: str) -> Level:
        """One level."""
        with self._uow() as uow:
            return uow.levels.get(level_id)

    def list_levels(
        self, venue_id: str | None = None, cursor: str | None = None, limit: int = DEFAULT_LIMIT
    ) -> Page[Level]:
        """Levels, newest first, of one venue if it is named."""
        with self._uow() as uow:
            if venue_id is not None:
                uow.venues.get(venue_id)
            return uow.levels.list(venue_id=venue_id, cursor=cursor, limit=check_limit(limit))

    def set_plan_image(self, level_id: str, png: bytes) -> None:
        """Store the plan image; it covers the level's extent."""
        with self._uow(write=True) as uow:
            uow.levels.set_plan_image(level_id, png, self._clock())

    def plan_image(self, level_id: str) -> bytes:
        """The plan image; NotFoundError if there is none."""
        with self._uow() as uow:
            png = uow.levels.plan_image(level_id)
        if png is None:
            raise NotFoundError("plan image of level", level_id)
        return png

    def set_vector_plan(self, level_id: str, geojson: bytes) -> None:
        """Store the vector plan, a GeoJSON feature collection in level metres."""
        _check_plan(geojson)
        with self._uow(write=True) as uow:
            uow.levels.set_vector_plan(level_id, geojson, self._clock())

    def vector_plan(self, level_id: str) -> bytes:
        """The vector plan; NotFoundError if there is none."""
        with self._uow() as uow:
            geojson = uow.levels.vector_plan(level_id)
        if geojson is None:
            raise NotFoundError("vector plan of level", level_id)
        return geojson


def _check_extent(extent: tuple[float, float, float, float]) -> None:
    x_min, y_min, x_max, y_max = extent
    if not all(map(math.isfinite, extent)) or x_min >= x_max or y_min >= y_max:
        raise InvalidError("extent", "is empty or not finite", "give x_min < x_max and y_min < y_max in metres")


def _check_plan(geojson: bytes) -> None:
    """Refuse here what would fail every later build of a map."""
    remedy = "send a GeoJSON FeatureCollection in level metres"
    try:
        plan = json.loads(geojson)
    except ValueError as error:
        raise InvalidError("plan", f"is not JSON: {error}", remedy) from error
    if not isinstance(plan, dict):
        raise InvalidError("plan", "is not a JSON object", remedy)
    try:
        FloorPlan.from_geojson(plan)
    except InputError as error:
        raise InvalidError(error.field, error.message, remedy) from error
