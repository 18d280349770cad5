"""Sessions: the trips of devices, their segments and positions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from app.engine.localization.particle import ParticleTracker
from app.engine.types import FixKind, Prior
from app.services.aids import Recording
from app.services.base import DEFAULT_LIMIT, Service, check_limit, check_number_cursor
from app.services.clock import Clock
from app.services.device_memory import starting_calibration
from app.services.errors import (
    InvalidError,
    OverloadedError,
    SequenceConflictError,
    SequenceGapError,
    SessionClosedError,
)
from app.services.ids import new_id
from app.services.level_frame import in_level_frame
from app.services.methods import MethodCheck, check_method, method_for
from app.services.new_jobs import new_job
from app.services.places import choose_place
from app.services.ports import JobListener, MapCache, UnitOfWork, UnitOfWorkFactory
from app.services.records import (
    Accepted,
    Job,
    JobKind,
    JobState,
    NewSegment,
    Page,
    Position,
    SegmentInfo,
    SegmentResult,
    Session,
    SessionStatus,
)
from app.services.session_end import end_if_over
from app.services.webhook_news import tell_closed

RETRY_AFTER_S = 2.0


class SessionService(Service):
    """Open and close sessions, accept segments, read what came of them."""

    def __init__(
        self,
        *,
        uow: UnitOfWorkFactory,
        clock: Clock,
        cache: MapCache,
        listener: JobListener,
        max_queued: int,
        check: MethodCheck = check_method,
    ) -> None:
        super().__init__(uow=uow, clock=clock)
        self._cache = cache
        self._listener = listener
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
        now = self._clock()
        with self._uow() as uow:
            start = starting_calibration(uow, device_id, calibration_epoch)
        with self._uow(write=True) as uow:
            place = choose_place(uow, level_id, venue_id, map_id, map_ids)
            chosen = method_for(uow, place, method, prior)
            if contributor is not None and chosen.name != ParticleTracker.method:
                raise InvalidError(
                    "contribute",
                    f"sessions of the method {chosen.name!r} have no smoothed track to offer",
                    f"use the method {ParticleTracker.method!r}, or leave contribute out",
                )
            session = Session(
                id=new_id("ses", now),
                venue_id=place.venue_id,
                level_id=place.level_id,
                maps=place.maps,
                device_id=device_id,
                method=chosen.name,
                method_reason=chosen.reason,
                parameters=dict(parameters),
                prior=replace(place.prior(prior), calibration=start.calibration),
                status=SessionStatus.OPEN,
                next_seq=0,
                created_at=now,
                closed_at=None,
                calibration_epoch=calibration_epoch,
                contributor=contributor,
            )
            uow.sessions.add(session)
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
            session = uow.sessions.close(session_id, now)
            if session.closed_at == now:  # not closed before
                tell_closed(uow, session)
            end_if_over(uow, session_id, now)
        return session

    def accept(self, session_id: str, new: NewSegment) -> Accepted:
        """Store a segment and its job in one transaction; after this nothing is lost.

        ``seq`` counts from 0 without gaps. The same ``seq`` with the same content gives the first answer again.
        """
        now = self._clock()
        with self._uow(write=True) as uow:
            session = uow.sessions.get(session_id)
            if new.seq < session.next_seq:
                return _repeated(uow, session_id, new)
            if session.status is SessionStatus.CLOSED:
                raise SessionClosedError(session_id)
            if new.seq > session.next_seq:
                raise SequenceGapError(new.seq, session.next_seq)
            _check_time(uow, session_id, new)
            in_level_frame(uow, session.venue_id, [Recording(new.samples, new.aids)])
            if uow.jobs.count(JobState.QUEUED, JobState.RUNNING) >= self._max_queued:
                raise OverloadedError(RETRY_AFTER_S)
            job = new_job(JobKind.LOCATE_SEGMENT, session_id, {"session_id": session_id, "seq": new.seq}, now)
            uow.jobs.add(job)
            uow.sessions.add_segment(session_id, new, job.id, now)
        self._listener.job_queued(job)
        return Accepted(_segment_info(session_id, new, job), job, repeated=False)

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


def _repeated(uow: UnitOfWork, session_id: str, new: NewSegment) -> Accepted:
    known = uow.sessions.get_segment(session_id, new.seq)
    if known.content_hash != new.content_hash:
        raise SequenceConflictError(new.seq)
    return Accepted(known, uow.jobs.get(known.job_id), repeated=True)


def _check_time(uow: UnitOfWork, session_id: str, new: NewSegment) -> None:
    """Phones sleep, so any gap between segments is fine; going back in time is not."""
    if not len(new.samples):
        raise InvalidError("samples.t_ms", "is empty", "send at least one sample")
    last = uow.sessions.last_segment(session_id)
    if last is not None and new.samples.t[0] <= last.t_end:
        raise InvalidError(
            "samples.t_ms",
            f"starts at {new.samples.t[0] * 1000:.3f}, not after the end of seq {last.seq}, {last.t_end * 1000:.3f}",
            "send each sample once, in time order",
        )


def _segment_info(session_id: str, new: NewSegment, job: Job) -> SegmentInfo:
    return SegmentInfo(
        session_id=session_id,
        seq=new.seq,
        content_hash=new.content_hash,
        n_samples=len(new.samples),
        t_start=float(new.samples.t[0]),
        t_end=float(new.samples.t[-1]),
        job_id=job.id,
        job_state=job.state,
        error=None,
        received_at=job.created_at,
        processed_at=None,
    )
