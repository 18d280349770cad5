"""What happens once a session is over: its device remembers, and maps are offered what it saw."""

from __future__ import annotations

from datetime import datetime

from app.services.device_memory import remember_if_over
from app.services.geofencing import leave_all
from app.services.new_jobs import new_job
from app.services.ports import UnitOfWork
from app.services.records import JobKind, SessionStatus


def end_if_over(uow: UnitOfWork, session_id: str, now: datetime) -> None:
    """Remember the device, leave all geofences, and queue the session's contribution if its application opted in.

    Each once.

    To be called in the transaction that closes the session or ends one of its jobs.
    """
    remember_if_over(uow, session_id, now)
    session = uow.sessions.get(session_id)
    if session.status is SessionStatus.OPEN or uow.jobs.is_pending(session_id):
        return
    leave_all(uow, session_id, now)
    if session.contributor is None:
        return
    key = _order_key(session_id)
    if not uow.jobs.is_pending(key) and not uow.contributions.of_session(session_id):
        uow.jobs.add(new_job(JobKind.CONTRIBUTE, key, {"session_id": session_id}, now))


def _order_key(session_id: str) -> str:
    """Not the session's own: its segments are done, and whoever waits for them need not wait for this."""
    return f"contribute_{session_id.removeprefix('ses_')}"
