"""Sessions: the trips of devices, their segments and positions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from app.engine.types import FixKind, Prior
from app.services.base import DEFAULT_LIMIT, Service, check_limit, check_number_cursor
from app.services.clock import Clock
from app.services.device_memory import starting_calibration
from app.services.errors import InvalidError
from app.services.live import SessionListener
from app.services.methods import MethodCheck, check_method
from app.services.open_sessions import NewSession, accept_segment, close_session, open_session
from app.services.ports import JobListener, MapCache, UnitOfWorkFactory
from app.services.records import (
    Accepted,
    NewSegment,
    Page,
    Position,
    SegmentInfo,
    SegmentResult,
    Session,
    SessionStatus,
)


class SessionService(Service):
    """Open and close sessions, accept segments, read what came of them."""

    def __init__(
        self,
        *,
        uow: UnitOfWorkFactory,
        clock: Clock,
        cache: MapCache,
        listener: JobListener,
        watchers: SessionListener,
        max_queued: int,
        check: MethodCheck = check_method,
    ) -> None:
        super().__init__(uow=uow, clock=clock)
        self._cache = cache
        self._listener = listener
        self._watchers = watchers
        self._max_queued = max_queued
        self._check = check

    def create(
        self,
        level_id: str | None,
        method: str,
        parameters: Mapping[str, object],
        prior: Prior | None = None,
        *,
        venue_id: str | None = None,
        device_id: str | None = None,
        map_id: str | None = None,
        map_ids: Sequence[str] = (),
        calibration_epoch: str = "",
        contributor: str | None = None,
    ) -> Session:
        """Open a session on a level, with its current map (or the named version) pinned.

        With ``venue_id`` instead of a level: on any level of the venue that has a map, with all of these pinned;
        ``map_ids`` are versions to pin in place of current ones. The session starts with what earlier ones taught about
        the device in this epoch of its magnetometer. With ``contributor``, the key that answers for it, what it saw is
        offered to the maps when it is closed.
        """
        self._check(method, parameters)
        new = NewSession(
            level_id=level_id,
            venue_id=venue_id,
            method=method,
            parameters=dict(parameters),
            prior=prior,
            device_id=device_id,
            map_id=map_id,
            map_ids=tuple(map_ids),
            calibration_epoch=calibration_epoch,
            contributor=contributor,
        )
        now = self._clock()
        with self._uow() as uow:
            start = starting_calibration(uow, device_id, calibration_epoch)
        with self._uow(write=True) as uow:
            session = open_session(uow, new, start.calibration, now)
        self._watchers.session_changed(session.id)
        return session

    def get(self, session_id: str) -> Session:
        """One session."""
        with self._uow() as uow:
            return uow.sessions.get(session_id)

    def list(
        self,
        level_id: str | None = None,
        device_id: str | None = None,
        status: SessionStatus | None = None,
        cursor: str | None = None,
        limit: int = DEFAULT_LIMIT,
        *,
        venue_id: str | None = None,
    ) -> Page[Session]:
        """Sessions, newest first."""
        with self._uow() as uow:
            return uow.sessions.list(
                venue_id=venue_id,
                level_id=level_id,
                device_id=device_id,
                status=status,
                cursor=cursor,
                limit=check_limit(limit),
            )

    def close(self, session_id: str) -> Session:
        """Take no more segments; those accepted are still processed. Closing again changes nothing.

        What the session learned about its device is remembered, now or when its last segment is done.
        """
        now = self._clock()
        with self._uow(write=True) as uow:
            session = close_session(uow, session_id, now)
        self._watchers.session_changed(session_id)
        return session

    def accept(self, session_id: str, new: NewSegment) -> Accepted:
        """Store a segment and its job in one transaction; after this nothing is lost.

        ``seq`` counts from 0 without gaps. The same ``seq`` with the same content gives the first answer again.
        """
        now = self._clock()
        with self._uow(write=True) as uow:
            accepted = accept_segment(uow, uow.sessions.get(session_id), new, now, max_queued=self._max_queued)
        if not accepted.repeated:
            self._listener.job_queued(accepted.job)
        return accepted

    def segment(self, session_id: str, seq: int) -> SegmentInfo:
        """One segment, without its samples."""
        with self._uow() as uow:
            return uow.sessions.get_segment(session_id, seq)

    def result(self, session_id: str, seq: int) -> SegmentResult:
        """One segment with its fixes."""
        with self._uow() as uow:
            return uow.sessions.get_result(session_id, seq)

    def segments(self, session_id: str, cursor: str | None = None, limit: int = DEFAULT_LIMIT) -> Page[SegmentInfo]:
        """Segments of a session, oldest first; the cursor is the last ``seq`` seen."""
        with self._uow() as uow:
            uow.sessions.get(session_id)
            return uow.sessions.list_segments(session_id, cursor=check_number_cursor(cursor), limit=check_limit(limit))

    def positions(
        self,
        session_id: str,
        seq: int | None = None,
        cursor: str | None = None,
        limit: int = DEFAULT_LIMIT,
        *,
        kind: FixKind = FixKind.FILTERED,
    ) -> Page[Position]:
        """Fixes of a session (told with one segment, if named) in time order; the cursor is the last number seen."""
        if kind is FixKind.SMOOTHED:
            raise InvalidError("kind", "smoothed positions are not stored", "ask for the trajectory of the session")
        with self._uow() as uow:
            uow.sessions.get(session_id)
            return uow.sessions.list_positions(
                session_id, seq=seq, cursor=check_number_cursor(cursor), limit=check_limit(limit), kind=kind
            )
