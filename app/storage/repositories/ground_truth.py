"""Known positions of sessions, and what was told there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from datetime import datetime
from typing import Any

from sqlalchemy import Row, bindparam, delete, func, insert, select, update

from app.engine.localization.marks import Mark, MarkMatch
from app.engine.types import Fix, Status
from app.services.ground_truth_records import Judged, TruthPoint
from app.services.records import Page
from app.services.stats_records import Filters, Window
from app.storage.models import fixes, ground_truth, sessions
from app.storage.repositories.activity import session_conditions
from app.storage.repositories.base import Repository, page

_CHUNK = 500  # parameters of one IN list; SQLite takes at least 999
_OF = ground_truth.c.session_id == bindparam("session")
_UNSETTLED = (
    select(ground_truth)
    .where(_OF, ground_truth.c.settled.is_(False))
    .order_by(ground_truth.c.number)
    .limit(bindparam("count"))
)
_SETTLE = (
    update(ground_truth)
    .where(_OF, ground_truth.c.number == bindparam("point"))
    .values(
        settled=bindparam("new_settled"),
        fix_x=bindparam("new_x"),
        fix_y=bindparam("new_y"),
        fix_level_id=bindparam("new_level"),
        apart_s=bindparam("new_apart"),
        error_m=bindparam("new_error"),
        normalized=bindparam("new_normalized"),
        inside=bindparam("new_inside"),
        sure=bindparam("new_sure"),
        status=bindparam("new_status"),
    )
)
_FIX_COLUMNS = [
    fixes.c[name]
    for name in ("t", "level_id", "x", "y", "cov_xx", "cov_xy", "cov_yy", "heading", "status", "quality", "sure")
]
_FIXES = (
    select(*_FIX_COLUMNS)
    .where(fixes.c.session_id == bindparam("session"), fixes.c.t >= bindparam("first"), fixes.c.t <= bindparam("last"))
    .order_by(fixes.c.number)
)
_LAST_FIX = select(fixes.c.t).where(fixes.c.session_id == bindparam("session")).order_by(fixes.c.number.desc()).limit(1)


class SqlGroundTruthRepository(Repository):
    """Port ``GroundTruthRepository``."""

    def add(self, session_id: str, marks: Sequence[Mark], now: datetime) -> Sequence[int]:
        """Store points and return their numbers; one of the same time as a stored point takes its place."""
        for i in range(0, len(marks), _CHUNK):
            times = [mark.t for mark in marks[i : i + _CHUNK]]
            again = delete(ground_truth).where(ground_truth.c.session_id == session_id, ground_truth.c.t.in_(times))
            self._write(again)
        last = select(func.max(ground_truth.c.number)).where(ground_truth.c.session_id == session_id)
        first = self._read(last).scalar()
        first = 0 if first is None else first + 1
        rows = [
            {
                "session_id": session_id,
                "number": first + i,
                "t": mark.t,
                "x": mark.x,
                "y": mark.y,
                "level_id": mark.level_id,
                "sd_m": mark.sd_m,
                "created_at": now,
                "settled": False,
            }
            for i, mark in enumerate(marks)
        ]
        if rows:
            self._write(insert(ground_truth), rows)
        return range(first, first + len(rows))

    def count(self, session_id: str) -> int:
        """How many points a session has."""
        statement = select(func.count()).where(ground_truth.c.session_id == session_id)
        return int(self._read(statement).scalar_one())

    def get(self, session_id: str, numbers: Sequence[int]) -> Sequence[TruthPoint]:
        """These points, in the order of their numbers; they follow one another without gaps."""
        if not numbers:
            return ()
        statement = select(ground_truth).where(
            ground_truth.c.session_id == session_id,
            ground_truth.c.number >= min(numbers),
            ground_truth.c.number <= max(numbers),
        )
        return tuple(_point(row) for row in self._read(statement.order_by(ground_truth.c.number)))

    def list(self, session_id: str, *, cursor: str | None, limit: int) -> Page[TruthPoint]:
        """Points of a session in the order in which they were stored; the cursor is the last ``number`` seen."""
        statement = select(ground_truth).where(ground_truth.c.session_id == session_id)
        if cursor is not None:
            statement = statement.where(ground_truth.c.number > int(cursor))
        rows = self._read(statement.order_by(ground_truth.c.number).limit(limit + 1)).all()
        return page(rows, _point, lambda row: str(row.number), limit=limit)

    def delete(self, session_id: str) -> None:
        """Forget all points of a session."""
        self._write(delete(ground_truth).where(ground_truth.c.session_id == session_id))

    def unsettled(self, session_id: str, *, limit: int) -> Sequence[TruthPoint]:
        """Points of a session that a later fix may still come nearer to."""
        rows = self._read(_UNSETTLED, {"session": session_id, "count": limit})
        return tuple(_point(row) for row in rows)

    def fixes_between(self, session_id: str, t_first: float, t_last: float) -> Sequence[Fix]:
        """Filtered fixes of these times (UTC seconds, both ends in), in time order, without their hypotheses."""
        rows = self._read(_FIXES, {"session": session_id, "first": t_first, "last": t_last})
        return tuple(_fix(row) for row in rows)

    def last_fix_t(self, session_id: str) -> float | None:
        """Time of the session's newest filtered fix, UTC seconds."""
        return self._read(_LAST_FIX, {"session": session_id}).scalar()

    def settle(self, points: Sequence[TruthPoint]) -> None:
        """Store ``match`` and ``settled`` of these points."""
        if points:
            self._write(_SETTLE, [_settled(point) for point in points])

    def judged(self, window: Window, filters: Filters, *, limit: int) -> Sequence[Judged]:
        """Matched points whose time lies in the window, newest first."""
        on_session = replace(filters, level_id=None)
        statement = (
            select(ground_truth, sessions.c.device_id, sessions.c.method)
            .join(sessions, sessions.c.id == ground_truth.c.session_id)
            .where(
                ground_truth.c.t >= window.since.timestamp(),
                ground_truth.c.t < window.until.timestamp(),
                ground_truth.c.error_m.is_not(None),
                *session_conditions(on_session),
            )
        )
        if filters.level_id is not None:
            statement = statement.where(ground_truth.c.fix_level_id == filters.level_id)
        rows = self._read(statement.order_by(ground_truth.c.t.desc()).limit(limit))
        return tuple(
            Judged(
                t=row._mapping["t"],  # row.t is SQLAlchemy's own
                level_id=row.fix_level_id,
                device_id=row.device_id,
                method=row.method,
                error_m=row.error_m,
                inside=row.inside,
                sure=row.sure,
            )
            for row in rows
        )


def _point(row: Row[Any]) -> TruthPoint:
    return TruthPoint(
        session_id=row.session_id,
        number=row.number,
        mark=Mark(row._mapping["t"], row.x, row.y, row.level_id, row.sd_m),
        created_at=row.created_at,
        settled=row.settled,
        match=None if row.error_m is None else _match(row),
    )


def _match(row: Row[Any]) -> MarkMatch:
    return MarkMatch(
        x=row.fix_x,
        y=row.fix_y,
        level_id=row.fix_level_id,
        apart_s=row.apart_s,
        error_m=row.error_m,
        normalized=row.normalized,
        inside=row.inside,
        sure=row.sure,
        status=Status(row.status),
    )


def _settled(point: TruthPoint) -> dict[str, Any]:
    match = point.match
    return {
        "session": point.session_id,
        "point": point.number,
        "new_settled": point.settled,
        "new_x": match and match.x,
        "new_y": match and match.y,
        "new_level": match and match.level_id,
        "new_apart": match and match.apart_s,
        "new_error": match and match.error_m,
        "new_normalized": match and match.normalized,
        "new_inside": match and match.inside,
        "new_sure": match and match.sure,
        "new_status": match and match.status,
    }


def _fix(row: Row[Any]) -> Fix:
    values = dict(row._mapping)
    return Fix(**{**values, "status": Status(values["status"])})
