"""Levels, their plans and current maps."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime
from typing import Any

from sqlalchemy import Row, delete, insert, select, update

from app.services.records import Found, Level, LevelMap, Page
from app.services.search import Search
from app.storage.models import current_maps, level_plans, levels, venues
from app.storage.places import box_columns, box_of
from app.storage.repositories.base import expect_one
from app.storage.repositories.placed import PlacedRepository
from app.storage.repositories.venues import anchor_of, level_box, venue_box

_IMAGE, _VECTOR = "image", "vector"
_SELECT = select(levels, current_maps.c.map_id).outerjoin(current_maps, current_maps.c.level_id == levels.c.id)


class SqlLevelRepository(PlacedRepository):
    """Port ``LevelRepository``."""

    def add(self, level: Level) -> None:
        """Store a level; its venue reaches as far as it does."""
        venue = self._one("venue", level.venue_id, select(venues).where(venues.c.id == level.venue_id))
        box = level_box(anchor_of(venue), level.extent)
        x_min, y_min, x_max, y_max = level.extent
        self._write(
            insert(levels).values(
                id=level.id,
                venue_id=level.venue_id,
                name=level.name,
                ordinal=level.ordinal,
                x_min=x_min,
                y_min=y_min,
                x_max=x_max,
                y_max=y_max,
                has_plan_image=level.has_plan_image,
                has_vector_plan=level.has_vector_plan,
                created_at=level.created_at,
                updated_at=level.updated_at,
                **box_columns(box),
            )
        )
        self._set_words(level.id, level.name, venue.name)
        if box is not None:
            whole = box.union(box_of(venue) or box)
            self._write(update(venues).where(venues.c.id == venue.id).values(box_columns(whole)))

    def get(self, level_id: str) -> Level:
        """One level."""
        return _level(self._one("level", level_id, _SELECT.where(levels.c.id == level_id)))

    def list(self, *, venue_id: str | None, cursor: str | None, limit: int) -> Page[Level]:
        """Levels, newest first."""
        statement = _SELECT if venue_id is None else _SELECT.where(levels.c.venue_id == venue_id)
        return self._newest_first(statement, levels.c.id, _level, cursor=cursor, limit=limit)

    def find(self, search: Search, *, venue_id: str | None, cursor: str | None, limit: int) -> Page[Found[Level]]:
        """Levels of a search: nearest first where it names a place, else newest first."""
        statement = _SELECT if venue_id is None else _SELECT.where(levels.c.venue_id == venue_id)
        if search.ordinal is not None:
            statement = statement.where(levels.c.ordinal == search.ordinal)
        return self._find(statement, levels, _level, search, cursor=cursor, limit=limit)

    def update(
        self, level_id: str, *, name: str, ordinal: int, extent: tuple[float, float, float, float], now: datetime
    ) -> Level:
        """Set name, storey and extent; the level and its venue are found where and as they are now."""
        before = self.get(level_id)
        venue = self._one("venue", before.venue_id, select(venues).where(venues.c.id == before.venue_id))
        x_min, y_min, x_max, y_max = extent
        corners = {"x_min": x_min, "y_min": y_min, "x_max": x_max, "y_max": y_max}
        box = level_box(anchor_of(venue), extent)
        values = {"name": name, "ordinal": ordinal, "updated_at": now, **corners, **box_columns(box)}
        self._write(update(levels).where(levels.c.id == level_id).values(values))
        if name != before.name:
            self._set_words(level_id, name, venue.name)
        if extent != before.extent:
            boxes = map(box_of, self._read(select(levels).where(levels.c.venue_id == before.venue_id)).all())
            whole = venue_box(anchor_of(venue), [one for one in boxes if one is not None])
            self._write(update(venues).where(venues.c.id == venue.id).values(box_columns(whole)))
        return self.get(level_id)

    def set_plan_image(self, level_id: str, png: bytes, now: datetime) -> None:
        """Store the plan image."""
        self._mark(level_id, now, has_plan_image=True)
        self._set_plan(level_id, _IMAGE, png)

    def plan_image(self, level_id: str) -> bytes | None:
        """The plan image, if there is one."""
        return self._plan(level_id, _IMAGE)

    def set_vector_plan(self, level_id: str, geojson: bytes, now: datetime) -> None:
        """Store the vector plan."""
        self._mark(level_id, now, has_vector_plan=True)
        self._set_plan(level_id, _VECTOR, geojson)

    def vector_plan(self, level_id: str) -> bytes | None:
        """The vector plan, if there is one."""
        return self._plan(level_id, _VECTOR)

    def set_current_map(self, level_id: str, map_id: str, now: datetime) -> str | None:
        """Make a map the one that new sessions use; returns the one of before."""
        self._mark(level_id, now)
        of_level = current_maps.c.level_id == level_id
        before: str | None = self._read(select(current_maps.c.map_id).where(of_level)).scalar()
        self._write(delete(current_maps).where(of_level))
        self._write(insert(current_maps).values(level_id=level_id, map_id=map_id))
        return before

    def current_maps(self, venue_id: str, *, limit: int) -> Sequence[LevelMap]:
        """Current maps of the venue's levels that have one, lowest level first, at most ``limit``."""
        statement = (
            select(levels.c.id, current_maps.c.map_id)
            .join(current_maps, current_maps.c.level_id == levels.c.id)
            .where(levels.c.venue_id == venue_id)
            .order_by(levels.c.ordinal, levels.c.id)
            .limit(limit)
        )
        return tuple(LevelMap(row.id, row.map_id) for row in self._read(statement))

    def _mark(self, level_id: str, now: datetime, **flags: bool) -> None:
        changed = self._write(update(levels).where(levels.c.id == level_id).values(updated_at=now, **flags))
        expect_one(changed, "level", level_id)

    def _set_plan(self, level_id: str, kind: str, data: bytes) -> None:
        of_level = (level_plans.c.level_id == level_id) & (level_plans.c.kind == kind)
        self._write(delete(level_plans).where(of_level))
        self._write(insert(level_plans).values(level_id=level_id, kind=kind, data=data))

    def _plan(self, level_id: str, kind: str) -> bytes | None:
        statement = (
            select(level_plans.c.data)
            .select_from(levels)
            .outerjoin(level_plans, (level_plans.c.level_id == levels.c.id) & (level_plans.c.kind == kind))
            .where(levels.c.id == level_id)
        )
        data: bytes | None = self._one("level", level_id, statement).data
        return data


def _level(row: Row[Any]) -> Level:
    return Level(
        id=row.id,
        venue_id=row.venue_id,
        name=row.name,
        ordinal=row.ordinal,
        extent=(row.x_min, row.y_min, row.x_max, row.y_max),
        has_plan_image=row.has_plan_image,
        has_vector_plan=row.has_vector_plan,
        current_map_id=row.map_id,
        created_at=row.created_at,
        updated_at=row.updated_at,
    )
