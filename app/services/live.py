"""What watchers of sessions read: new positions of one, and where many are now."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from app.engine.types import FixKind
from app.services.base import MAX_LIMIT, Service
from app.services.records import LastKnown, Position, Session, SessionStatus

MAX_LIVE = 1000
"""Sessions in one snapshot: those opened last."""


class SessionListener(Protocol):
    """Told after commit that a session was opened or closed."""

    def session_changed(self, session_id: str) -> None:
        """Pass it on; must neither block nor raise."""
        ...


@dataclass(frozen=True, slots=True)
class News:
    """What came of a session since a position: the next positions, and whether more can come."""

    positions: Sequence[Position]
    complete: bool
    """Whether these are all there are so far."""
    session: Session
    over: bool
    """Closed, and its last segment is processed: these positions were the last."""


class LiveService(Service):
    """Read sessions while they run."""

    def news(self, session_id: str, after: int, kind: FixKind = FixKind.FILTERED) -> News:
        """Positions numbered above ``after`` (-1: all), at most a page of them."""
        with self._uow() as uow:
            # Read before the positions: a session that was over by then has told all of them.
            session = uow.sessions.get(session_id)
            over = session.status is SessionStatus.CLOSED and not uow.jobs.is_pending(session_id)
            page = uow.sessions.list_positions(session_id, seq=None, cursor=str(after), limit=MAX_LIMIT, kind=kind)
        complete = page.next_cursor is None
        return News(page.items, complete, session, over and complete)

    def snapshot(self, venue_id: str | None = None, level_id: str | None = None) -> Sequence[LastKnown]:
        """Open sessions with their last positions, newest first."""
        with self._uow() as uow:
            if venue_id is not None:
                uow.venues.get(venue_id)
            if level_id is not None:
                uow.levels.get(level_id)
            return uow.sessions.last_known(venue_id=venue_id, level_id=level_id, limit=MAX_LIVE)

    def last_known(
        self, session_ids: Sequence[str], venue_id: str | None = None, level_id: str | None = None
    ) -> Sequence[LastKnown]:
        """These sessions with their last positions, open or not."""
        with self._uow() as uow:
            return uow.sessions.last_known(
                venue_id=venue_id, level_id=level_id, only=session_ids[:MAX_LIVE], limit=MAX_LIVE
            )
