"""The durable queue."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import datetime
from typing import Any

from sqlalchemy import Row, Update, bindparam, func, insert, select, update

from app.services.records import Job, JobKind, JobState, Page
from app.storage.models import jobs
from app.storage.repositories.base import Repository

_GET = select(jobs).where(jobs.c.id == bindparam("job"))
_INSERT = insert(jobs)
_COUNT = select(func.count()).where(jobs.c.state.in_(bindparam("states", expanding=True)))
_PENDING = (
    select(jobs.c.number)
    .where(jobs.c.state.in_([JobState.QUEUED.value, JobState.RUNNING.value]), jobs.c.order_key == bindparam("key"))
    .limit(1)
)
_BUSY = select(jobs.c.order_key).where(jobs.c.state == JobState.RUNNING.value)
# oldest queued job of each key that has none running; this reads the index only
_CLAIMABLE = (
    select(func.min(jobs.c.number).label("number"))
    .where(jobs.c.state == JobState.QUEUED.value, jobs.c.order_key.not_in(_BUSY))
    .group_by(jobs.c.order_key)
    .order_by("number")
    .limit(bindparam("limit"))
)
_CLAIMABLE_OF_KIND = _CLAIMABLE.where(jobs.c.kind == bindparam("kind"))
_CLAIM = (
    update(jobs)
    .where(jobs.c.number.in_(bindparam("numbers", expanding=True)), jobs.c.state == JobState.QUEUED.value)
    .values(state=JobState.RUNNING.value, attempts=jobs.c.attempts + 1, started_at=bindparam("now"))
    .returning(*jobs.c)
)


class SqlJobRepository(Repository):
    """Port ``JobRepository``."""

    def add(self, job: Job) -> None:
        """Queue a job."""
        self._write(
            _INSERT,
            {
                "id": job.id,
                "kind": job.kind,
                "state": job.state,
                "order_key": job.order_key,
                "subject": dict(job.subject),
                "attempts": job.attempts,
                "progress": job.progress,
                "progress_text": job.progress_text,
                "result": dict(job.result),
                "error": job.error,
                "created_at": job.created_at,
                "started_at": job.started_at,
                "finished_at": job.finished_at,
            },
        )

    def get(self, job_id: str) -> Job:
        """One job."""
        return _job(self._one("job", job_id, _GET, {"job": job_id}))

    def list(self, *, kinds: Sequence[JobKind], state: JobState | None, cursor: str | None, limit: int) -> Page[Job]:
        """Jobs, newest first."""
        statement = select(jobs)
        if kinds:
            statement = statement.where(jobs.c.kind.in_(kinds))
        if state is not None:
            # nearly all jobs are done: the list itself fills a page at once, sorting an index does not
            unsorted = func.coalesce(jobs.c.state, "") if state is JobState.DONE else jobs.c.state
            statement = statement.where(unsorted == state)
        return self._newest_first(statement, jobs.c.id, _job, cursor=cursor, limit=limit)

    def claim(self, *, limit: int, now: datetime, kind: JobKind | None = None) -> Sequence[Job]:
        """Mark up to ``limit`` queued jobs as running, oldest first, one per key and none of a busy key."""
        if kind is None:
            numbers = self._read(_CLAIMABLE, {"limit": limit}).scalars().all()
        else:
            numbers = self._read(_CLAIMABLE_OF_KIND, {"limit": limit, "kind": kind}).scalars().all()
        if not numbers:
            return ()
        rows = self._write(_CLAIM, {"numbers": numbers, "now": now}).all()
        return tuple(_job(row) for row in sorted(rows, key=lambda row: int(row.number)))

    def requeue_running(self) -> int:
        """Queue again all that is running."""
        statement = update(jobs).where(jobs.c.state == JobState.RUNNING).values(state=JobState.QUEUED, started_at=None)
        return self._write(statement).rowcount

    def requeue(self, job_id: str, *, attempts: int | None = None) -> bool:
        """Queue a *running* job again (of this attempt only, if given); False if it does not run."""
        statement = _of_attempt(update(jobs).where(jobs.c.id == job_id), attempts)
        statement = statement.where(jobs.c.state == JobState.RUNNING)
        return self._write(statement.values(state=JobState.QUEUED, started_at=None)).rowcount > 0

    def set_progress(self, job_id: str, fraction: float, text: str) -> None:
        """Show how far a running job is."""
        self._write(
            update(jobs)
            .where(jobs.c.id == job_id, jobs.c.state == JobState.RUNNING)
            .values(progress=fraction, progress_text=text)
        )

    def finish(
        self,
        job_id: str,
        state: JobState,
        now: datetime,
        *,
        result: Mapping[str, str | int | float] | None = None,
        error: str | None = None,
        attempts: int | None = None,
    ) -> bool:
        """Move a running (or, for cancellation, queued) job to a final state; False if it was final already."""
        leaves = [JobState.RUNNING, JobState.QUEUED] if state is JobState.CANCELLED else [JobState.RUNNING]
        values: dict[str, Any] = {"state": state, "finished_at": now, "result": dict(result or {}), "error": error}
        if state is JobState.DONE:
            values["progress"] = 1.0
        statement = _of_attempt(update(jobs).where(jobs.c.id == job_id, jobs.c.state.in_(leaves)), attempts)
        if self._write(statement.values(values)).rowcount:
            return True
        self.get(job_id)  # NotFoundError if there is no such job
        return False

    def count(self, *states: JobState) -> int:
        """How many jobs are in these states."""
        return int(self._read(_COUNT, {"states": states}).scalar_one())

    def is_pending(self, order_key: str) -> bool:
        """Whether a job of this key is queued or running."""
        return self._read(_PENDING, {"key": order_key}).first() is not None


def _of_attempt(statement: Update, attempts: int | None) -> Update:
    return statement if attempts is None else statement.where(jobs.c.attempts == attempts)


def _job(row: Row[Any]) -> Job:
    return Job(
        id=row.id,
        kind=JobKind(row.kind),
        state=JobState(row.state),
        order_key=row.order_key,
        subject=row.subject,
        attempts=row.attempts,
        progress=row.progress,
        progress_text=row.progress_text,
        result=row.result,
        error=row.error,
        created_at=row.created_at,
        started_at=row.started_at,
        finished_at=row.finished_at,
    )
