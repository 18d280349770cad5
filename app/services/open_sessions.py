"""Sessions opened and segments taken, inside a transaction of whoever does it: an API call, or a phone's message."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from datetime import datetime

from app.engine.localization.particle import ParticleTracker
from app.engine.types import DeviceCalibration, Prior
from app.services.aids import Recording
from app.services.errors import (
    InvalidError,
    OverloadedError,
    SequenceConflictError,
    SequenceGapError,
    SessionClosedError,
)
from app.services.ids import new_id
from app.services.level_frame import in_level_frame
from app.services.methods import method_for
from app.services.new_jobs import new_job
from app.services.places import choose_place
from app.services.ports import UnitOfWork
from app.services.records import (
    Accepted,
    Job,
    JobKind,
    JobState,
    NewSegment,
    SegmentInfo,
    Session,
    SessionStatus,
)
from app.services.session_end import end_if_over
from app.services.webhook_news import tell_closed

RETRY_AFTER_S = 2.0


@dataclass(frozen=True, slots=True)
class NewSession:
    """What is said of a session to open: exactly one of level and venue."""

    level_id: str | None
    venue_id: str | None
    method: str
    parameters: Mapping[str, object] = field(default_factory=dict)
    prior: Prior | None = None
    device_id: str | None = None
    map_id: str | None = None
    map_ids: tuple[str, ...] = ()
    calibration_epoch: str = ""
    contributor: str | None = None


def open_session(uow: UnitOfWork, new: NewSession, calibration: DeviceCalibration | None, now: datetime) -> Session:
    """Store a session that starts with this calibration; NoMapError if there is no map to use."""
    place = choose_place(uow, new.level_id, new.venue_id, new.map_id, new.map_ids)
    chosen = method_for(uow, place, new.method, new.prior)
    if new.contributor is not None and chosen.name != ParticleTracker.method:
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
        device_id=new.device_id,
        method=chosen.name,
        method_reason=chosen.reason,
        parameters=dict(new.parameters),
        prior=replace(place.prior(new.prior), calibration=calibration),
        status=SessionStatus.OPEN,
        next_seq=0,
        created_at=now,
        closed_at=None,
        calibration_epoch=new.calibration_epoch,
        contributor=new.contributor,
    )
    uow.sessions.add(session)
    return session


def close_session(uow: UnitOfWork, session_id: str, now: datetime) -> Session:
    """Take no more segments; those accepted are still processed. Closing again changes nothing."""
    session = uow.sessions.close(session_id, now)
    if session.closed_at == now:  # not closed before
        tell_closed(uow, session)
    end_if_over(uow, session_id, now)
    return session


def accept_segment(uow: UnitOfWork, session: Session, new: NewSegment, now: datetime, *, max_queued: int) -> Accepted:
    """Store a segment and its job; whoever calls tells the listener of the job after the commit.

    ``session`` was read in this writing transaction.
    """
    if new.seq < session.next_seq:
        return _repeated(uow, session.id, new)
    if session.status is SessionStatus.CLOSED:
        raise SessionClosedError(session.id)
    if new.seq > session.next_seq:
        raise SequenceGapError(new.seq, session.next_seq)
    _check_time(uow, session.id, new)
    in_level_frame(uow, session.venue_id, [Recording(new.samples, new.aids)])
    if uow.jobs.count(JobState.QUEUED, JobState.RUNNING) >= max_queued:
        raise OverloadedError(RETRY_AFTER_S)
    job = new_job(JobKind.LOCATE_SEGMENT, session.id, {"session_id": session.id, "seq": new.seq}, now)
    uow.jobs.add(job)
    uow.sessions.add_segment(session.id, new, job.id, now)
    return Accepted(_segment_info(session.id, new, job), job, repeated=False)


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
