"""The segments of a session as they are stored, for use cases that go through all of them at once."""

from __future__ import annotations

from app.engine.types import Segment
from app.services.errors import InvalidError, UnfitSessionError
from app.services.level_frame import in_level_frame
from app.services.ports import UnitOfWork
from app.services.records import JobState, Session

MAX_SEGMENTS = 360
MAX_SPAN_S = 1800.0
"""Half an hour of usual segments: a worker holds all of it, and somebody waits."""


def load_segments(uow: UnitOfWork, session: Session, refusal: type[UnfitSessionError]) -> tuple[Segment, ...]:
    """Segments whose job is done, oldest first; ``refusal`` before any are read if they are too many or too long."""
    remedy = f"read its positions, and open a new session every {MAX_SPAN_S / 60:.0f} minutes"
    if session.next_seq > MAX_SEGMENTS:
        raise refusal("session_id", f"{session.next_seq} segments, more than {MAX_SEGMENTS}", remedy)
    infos = uow.sessions.list_segments(session.id, cursor=None, limit=MAX_SEGMENTS).items
    span = sum(info.t_end - info.t_start for info in infos if info.job_state is JobState.DONE)
    if span > MAX_SPAN_S:
        message = f"{span / 60:.1f} minutes of samples, more than {MAX_SPAN_S / 60:.0f}"
        raise refusal("session_id", message, remedy)
    recordings = uow.sessions.load_segments(session.id, MAX_SEGMENTS)
    try:
        return in_level_frame(uow, session.venue_id, recordings)
    except InvalidError as error:  # the anchor was changed since: what is stored stands against it, not the request
        raise refusal(error.field, error.message, error.remedy) from error
