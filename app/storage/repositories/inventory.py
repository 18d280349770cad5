"""What is there now: bytes, levels with their maps, open sessions, and what became of the field lately."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import datetime
from typing import Any

from sqlalchemy import Row, Table, bindparam, func, literal_column, select

from app.services.records import ContributionState, LastingChange, SessionStatus
from app.services.stats_records import LastHeard, LevelRow, StorageRow, Window
from app.storage import models
from app.storage.models import (
    contributions,
    current_maps,
    field_changes,
    levels,
    maps,
    segments,
    sessions,
    surveys,
    walks,
)
from app.storage.repositories.activity import first_id, time_of
from app.storage.repositories.base import Repository

_SAMPLED = 200
_PARTS: Mapping[str, tuple[tuple[Table, tuple[str, ...]], ...]] = {
    "segments": ((models.segment_samples, ("samples", "wifi", "ble", "gnss", "pressure", "speed", "steps")),),
    "walks": ((models.walk_samples, ("samples", "waypoints", "wifi", "ble")),),
    "map_tiles": (
        (models.tiles, ("data",)),
        (models.radio_layers, ("data",)),
        (models.route_layers, ("data",)),
    ),
    "evidence": ((models.evidence_tiles, ("data",)), (models.contribution_rows, ("data",))),
    "tracker_states": ((models.tracker_states, ("payload",)),),
    "plans": ((models.level_plans, ("data",)),),
}
"""Tables with blobs, by what they hold; everything else is small rows."""
_ROW_BYTES: Mapping[str, tuple[Table, int]] = {
    "fixes": (models.fixes, 180),
    "fixed_lag_fixes": (models.lagged_fixes, 180),
    "segment_rows": (models.segments, 245),
    "jobs": (models.jobs, 520),
}
"""Tables of many small rows, with the bytes that a row takes in its table and indexes (2,000 segments in SQLite)."""


def _of_sessions(column: Any) -> Any:
    """Something of the level's sessions that were opened between ``low`` and ``high``."""
    return (
        select(column)
        .where(sessions.c.level_id == levels.c.id, sessions.c.id >= bindparam("low"), sessions.c.id < bindparam("high"))
        .scalar_subquery()
    )


def _of_walks(column: Any) -> Any:
    joined = surveys.join(walks, walks.c.survey_id == surveys.c.id)
    return select(column).select_from(joined).where(surveys.c.level_id == levels.c.id).scalar_subquery()


_LEVELS = (
    select(
        levels.c.id,
        levels.c.venue_id,
        levels.c.name,
        _of_sessions(func.count()).label("n_sessions"),
        _of_sessions(func.max(sessions.c.id)).label("last_session"),
        _of_walks(func.count()).label("n_walks"),
        _of_walks(func.max(walks.c.created_at)).label("last_walk_at"),
        maps.c.id.label("map_id"),
        maps.c.version,
        maps.c.created_at.label("map_created_at"),
    )
    .outerjoin(current_maps, current_maps.c.level_id == levels.c.id)
    .outerjoin(maps, maps.c.id == current_maps.c.map_id)
)


class SqlInventoryRepository(Repository):
    """Port ``InventoryRepository``."""

    def storage(self) -> Sequence[StorageRow]:
        """Bytes of each group of tables: rows counted, times the mean size of some."""
        blobs = [_added(part, [self._size(table, names) for table, names in of]) for part, of in _PARTS.items()]
        small = [_small_rows(part, self._count(table), each) for part, (table, each) in _ROW_BYTES.items()]
        return (*blobs, *small)

    def levels(
        self, window: Window, *, venue_id: str | None, level_id: str | None, cursor: str | None, limit: int
    ) -> Sequence[LevelRow]:
        """Levels, newest first, without their maps' ages."""
        statement = _LEVELS
        for column, value in ((levels.c.venue_id, venue_id), (levels.c.id, level_id)):
            statement = statement if value is None else statement.where(column == value)
        if cursor is not None:
            statement = statement.where(levels.c.id < cursor)
        rows = self._read(
            statement.order_by(levels.c.id.desc()).limit(limit),
            {"low": first_id("ses", window.since), "high": first_id("ses", window.until)},
        )
        return tuple(_level(row) for row in rows)

    def open_sessions(self, *, limit: int) -> Sequence[LastHeard]:
        """The newest open sessions, and when each was heard of last."""
        last = (
            select(segments.c.received_at)
            .where(segments.c.session_id == sessions.c.id)
            .order_by(segments.c.seq.desc())
            .limit(1)
            .scalar_subquery()
        )
        statement = (
            select(sessions.c.id, sessions.c.device_id, sessions.c.created_at, last.label("last_at"))
            .where(sessions.c.status == SessionStatus.OPEN.value)
            .order_by(sessions.c.id.desc())
            .limit(limit)
        )
        return tuple(LastHeard(row.id, row.device_id, row.last_at or row.created_at) for row in self._read(statement))

    def quarantined(self, since: datetime) -> Mapping[str, int]:
        """Contributions of each level that were made since and quarantined."""
        statement = (
            select(contributions.c.level_id, func.count().label("n"))
            .where(
                contributions.c.id >= first_id("ctr", since),
                contributions.c.state == ContributionState.QUARANTINED.value,
            )
            # not by the bare column: its index would be read from end to end
            .group_by(func.coalesce(contributions.c.level_id, ""))
        )
        return {row.level_id: row.n for row in self._read(statement)}

    def changes(self, since: datetime, *, limit: int) -> Sequence[LastingChange]:
        """Lasting changes found since, newest first."""
        statement = (
            select(field_changes)
            .where(field_changes.c.created_at >= since)
            .order_by(field_changes.c.id.desc())
            .limit(limit)
        )
        return tuple(
            LastingChange(**{**row._mapping, "box": tuple(row.box), "delta": tuple(row.delta)})
            for row in self._read(statement)
        )

    def _count(self, table: Table) -> int:
        return int(self._read(select(func.count()).select_from(table)).scalar_one())

    def _size(self, table: Table, names: Sequence[str]) -> tuple[int, int]:
        """Rows, and about how many bytes their blobs have."""
        n = self._count(table)
        if not n:
            return 0, 0
        size: Any = sum((func.coalesce(func.length(table.c[name]), 0) for name in names), start=literal_column("0"))
        some = select(size.label("size")).select_from(table).limit(_SAMPLED).subquery()
        mean = self._read(select(func.avg(some.c.size))).scalar()
        return n, round(n * float(mean or 0.0))


def _added(part: str, sizes: Sequence[tuple[int, int]]) -> StorageRow:
    return StorageRow(part, sum(n for n, _ in sizes), sum(size for _, size in sizes), estimated=True)


def _small_rows(part: str, n: int, each: int) -> StorageRow:
    return StorageRow(part, n, n * each, estimated=True)


def _level(row: Row[Any]) -> LevelRow:
    last_walk_at, map_created_at = row.last_walk_at, row.map_created_at
    return LevelRow(
        level_id=row.id,
        venue_id=row.venue_id,
        name=row.name,
        sessions=row.n_sessions,
        last_session_at=None if row.last_session is None else time_of(row.last_session),
        walks=row.n_walks,
        last_walk_at=last_walk_at,
        map_id=row.map_id,
        map_version=row.version,
        map_created_at=map_created_at,
        map_age_days=None,
        map_behind=last_walk_at is not None and map_created_at is not None and last_walk_at > map_created_at,
    )
