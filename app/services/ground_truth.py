"""Ground truth: known positions of sessions beside what was told there, so that claims can be checked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from app.engine.localization.marks import WITHIN_S, Mark, match_mark
from app.services.base import DEFAULT_LIMIT, Service, check_limit, check_number_cursor
from app.services.errors import ConflictError, InvalidError
from app.services.ground_truth_records import TruthPoint
from app.services.ports import UnitOfWork
from app.services.records import Page, Session

MAX_POINTS = 5000
"""Known positions a session may have."""
SLACK_M = 50.0
"""How far outside its level a known position may lie."""


class GroundTruthService(Service):
    """Add, read and forget the known positions of a session."""

    def add(self, session_id: str, points: Sequence[Mark]) -> Sequence[TruthPoint]:
        """Store known positions (times in UTC seconds) and match them with the fixes there are.

        One of the same time as an earlier one takes its place. What no fix is near yet is matched when one comes.
        """
        with self._uow(write=True) as uow:
            session = uow.sessions.get(session_id)
            marks = list({mark.t: mark for mark in points}.values())
            _check(uow, session, marks)
            numbers = uow.ground_truth.add(session_id, marks, self._clock())
            if uow.ground_truth.count(session_id) > MAX_POINTS:
                raise ConflictError(f"session {session_id} would have more than {MAX_POINTS} known positions")
            settle(uow, session_id)
            return uow.ground_truth.get(session_id, numbers)

    def list(self, session_id: str, cursor: str | None = None, limit: int = DEFAULT_LIMIT) -> Page[TruthPoint]:
        """Known positions of a session in the order in which they came."""
        with self._uow() as uow:
            uow.sessions.get(session_id)  # NotFoundError if there is none
            return uow.ground_truth.list(session_id, cursor=check_number_cursor(cursor), limit=check_limit(limit))

    def forget(self, session_id: str) -> None:
        """Delete all known positions of a session."""
        with self._uow(write=True) as uow:
            uow.sessions.get(session_id)
            uow.ground_truth.delete(session_id)


def settle(uow: UnitOfWork, session_id: str) -> None:
    """Match what is open among a session's known positions; to be called when points or fixes have come.

    A point stays open until fixes lie beyond its reach: until then a nearer one, or one on its other side, may come.
    """
    points = uow.ground_truth.unsettled(session_id, limit=MAX_POINTS)
    if not points:
        return
    times = [point.mark.t for point in points]
    fixes = uow.ground_truth.fixes_between(session_id, min(times) - WITHIN_S, max(times) + WITHIN_S)
    last = uow.ground_truth.last_fix_t(session_id)
    matched = [
        replace(
            point,
            match=match_mark(point.mark, fixes),
            settled=last is not None and last >= point.mark.t + WITHIN_S,
        )
        for point in points
    ]
    uow.ground_truth.settle([new for new, old in zip(matched, points, strict=True) if new != old])


def _check(uow: UnitOfWork, session: Session, marks: Sequence[Mark]) -> None:
    extents: dict[str, tuple[float, float, float, float]] = {}
    for i, mark in enumerate(marks):
        level_id = mark.level_id or session.level_id
        if level_id is None:
            continue
        if level_id not in extents:
            level = uow.levels.get(level_id)
            if level.venue_id != session.venue_id or session.level_id not in (None, level_id):
                raise InvalidError(
                    f"level_id.{i}", f"{level_id} is not where the session is", "name a level of the session"
                )
            extents[level_id] = level.extent
        x_min, y_min, x_max, y_max = extents[level_id]
        for name, value, low, high in (("x", mark.x, x_min, x_max), ("y", mark.y, y_min, y_max)):
            if not low - SLACK_M <= value <= high + SLACK_M:
                raise InvalidError(
                    f"{name}.{i}",
                    f"{value:g} m lies more than {SLACK_M:g} m outside the level ({low:g} to {high:g} m)",
                    "give level metres",
                )
