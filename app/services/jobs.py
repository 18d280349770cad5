"""Jobs: what is queued, running and finished."""

from __future__ import annotations

from collections.abc import Sequence

from app.services.base import DEFAULT_LIMIT, Service, check_limit
from app.services.clock import Clock
from app.services.errors import ConflictError
from app.services.map_changes import queue_update
from app.services.ports import JobListener, UnitOfWork, UnitOfWorkFactory
from app.services.records import Job, JobKind, JobState, MapKind, Page
from app.services.session_end import end_if_over

CANCELLED = "cancelled on request"


class JobService(Service):
    """Read and cancel jobs."""

    def __init__(self, *, uow: UnitOfWorkFactory, clock: Clock, listener: JobListener) -> None:
        super().__init__(uow=uow, clock=clock)
        self._listener = listener

    def get(self, job_id: str) -> Job:
        """One job."""
        with self._uow() as uow:
            return uow.jobs.get(job_id)

    def list(
        self,
        kinds: Sequence[JobKind] = (),
        state: JobState | None = None,
        cursor: str | None = None,
        limit: int = DEFAULT_LIMIT,
    ) -> Page[Job]:
        """Jobs, newest first; of these kinds only, when any are named."""
        with self._uow() as uow:
            return uow.jobs.list(kinds=kinds, state=state, cursor=cursor, limit=check_limit(limit))

    def cancel(self, job_id: str) -> Job:
        """Cancel a queued or running job; a worker's later answer is dropped.

        Cancelling twice changes nothing; ConflictError if the job ended in another way.
        """
        now = self._clock()
        with self._uow(write=True) as uow:
            cancelled = uow.jobs.finish(job_id, JobState.CANCELLED, now, error=CANCELLED)
            job = uow.jobs.get(job_id)
            if cancelled:
                record_failure(uow, job, CANCELLED)
        if cancelled:
            self._listener.job_finished(job)
        elif job.state is not JobState.CANCELLED:
            raise ConflictError(f"job {job_id} is {job.state} already and cannot be cancelled")
        return job


def record_failure(uow: UnitOfWork, job: Job, error: str) -> None:
    """What follows of a job that came to nothing.

    Its segment, if it has one, gave no fixes; the session goes on with the state it had. Contributions that waited for
    a build, which would have been followed by an update, get one now.
    """
    if job.kind is JobKind.BUILD_MAP and job.finished_at is not None:
        # not after an update: the next would come to nothing for the same reason
        if uow.maps.get_build(job.id).mode is MapKind.BUILD:
            queue_update(uow, str(job.subject["level_id"]), job.finished_at)
    elif job.kind is JobKind.LOCATE_SEGMENT and job.finished_at is not None:
        session_id = str(job.subject["session_id"])
        uow.sessions.record_failure(session_id, int(job.subject["seq"]), error, job.finished_at)
        end_if_over(uow, session_id, job.finished_at)
