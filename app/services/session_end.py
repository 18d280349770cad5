"""What happens once a session is over: its device remembers, and maps are offered what it saw."""

from __future__ import annotations

from datetime import datetime

from app.services.device_memory import remember_if_over
from app.services.ids import new_id
from app.services.ports import UnitOfWork
from app.services.records import Job, JobKind, JobState, SessionStatus


def end_if_over(uow: UnitOfWork, session_id: str, now: datetime) -> None:
    """Remember the device, and queue the session's contribution if its application opted in; each once.

    To be called in the transaction that closes the session or ends one of its jobs.
    """
    remember_if_over(uow, session_id, now)
    session = uow.sessions.get(session_id)
    if session.contributor is None or session.status is SessionStatus.OPEN or uow.jobs.is_pending(session_id):
        return
    key = _order_key(session_id)
    if not uow.jobs.is_pending(key) and not uow.contributions.of_session(session_id):
        uow.jobs.add(_contribute_job(session_id, key, now))


def _order_key(session_id: str) -> str:
    """Not the session's own: its segments are done, and whoever waits for them need not wait for this."""
    return f"contribute_{session_id.removeprefix('ses_')}"


def _contribute_job(session_id: str, key: str, now: datetime) -> Job:
    return Job(
        id=new_id("job", now),
        kind=JobKind.CONTRIBUTE,
        state=JobState.QUEUED,
        order_key=key,
        subject={"session_id": session_id},
        attempts=0,
        progress=0.0,
        progress_text="",
        result={},
        error=None,
        created_at=now,
        started_at=None,
        finished_at=None,
    )
