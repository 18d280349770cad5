"""Jobs as they are queued."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime

from app.services.ids import new_id
from app.services.records import Job, JobKind, JobState


def new_job(kind: JobKind, order_key: str, subject: Mapping[str, str | int], now: datetime) -> Job:
    """A job that nobody has begun; jobs of one ``order_key`` run one after the other."""
    return Job(
        id=new_id("job", now),
        kind=kind,
        state=JobState.QUEUED,
        order_key=order_key,
        subject=subject,
        attempts=0,
        progress=0.0,
        progress_text="",
        result={},
        error=None,
        created_at=now,
        started_at=None,
        finished_at=None,
    )
