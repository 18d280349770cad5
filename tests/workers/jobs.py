from datetime import UTC, datetime, timedelta

from app.services.records import Job, JobKind, JobState

T0 = datetime(2026, 1, 1, tzinfo=UTC)


def make_job(
    job_id: str, state: JobState = JobState.DONE, *, kind: JobKind = JobKind.LOCATE_SEGMENT, order_key: str = "ses_1"
) -> Job:
    final = state in (JobState.DONE, JobState.FAILED, JobState.CANCELLED)
    return Job(
        id=job_id,
        kind=kind,
        state=state,
        order_key=order_key,
        subject={},
        attempts=0,
        progress=0.0,
        progress_text="",
        result={},
        error=None,
        created_at=T0,
        started_at=None if state is JobState.QUEUED else T0,
        finished_at=T0 + timedelta(seconds=1) if final else None,
    )
