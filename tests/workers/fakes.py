"""A durable queue in memory, and an executor that the test settles by hand."""

import threading
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field, replace
from typing import Any

from app.engine.types import Progress
from app.services.records import Job, JobKind, JobState
from tests.workers.jobs import make_job


class FakeProcessing:
    """The rules of the queue: one running job an order key, oldest first, attempts fence late answers."""

    def __init__(self) -> None:
        self.lock = threading.Lock()
        self.jobs: dict[str, Job] = {}
        self.completed: list[tuple[str, object]] = []
        self.reports: list[tuple[str, float, str]] = []
        self.claims = 0
        self.break_next: dict[str, int] = {}
        self.trouble: Callable[[str], Exception] = lambda what: OSError(f"{what}: disk on fire")

    def add(self, *jobs: Job) -> None:
        with self.lock:
            self.jobs.update({job.id: job for job in jobs})

    def state(self, job_id: str) -> JobState:
        with self.lock:
            return self.jobs[job_id].state

    def claim(self, limit: int, kind: JobKind | None = None) -> Sequence[Job]:
        self.claims += 1
        self._maybe_break("claim")
        with self.lock:
            busy = {job.order_key for job in self.jobs.values() if job.state is JobState.RUNNING}
            claimed: list[Job] = []
            for job in sorted(self.jobs.values(), key=lambda job: job.id):
                free = job.state is JobState.QUEUED and job.order_key not in busy
                if free and len(claimed) < limit and kind in (None, job.kind):
                    busy.add(job.order_key)
                    claimed.append(replace(job, state=JobState.RUNNING, attempts=job.attempts + 1))
            self.jobs.update({job.id: job for job in claimed})
            return claimed

    def prepare(self, job: Job) -> str:
        self._maybe_break("prepare")
        return job.id

    def complete(self, job: Job, result: object) -> Job | None:
        self._maybe_break("complete")
        with self.lock:
            now = self.jobs[job.id]
            if now.state is not JobState.RUNNING or now.attempts != job.attempts:
                return None
            self.completed.append((job.id, result))
            self.jobs[job.id] = replace(now, state=JobState.DONE)
            return self.jobs[job.id]

    def fail(self, job: Job, error: str) -> Job:
        self._maybe_break("fail")
        return self._set(job, JobState.FAILED, error)

    def retry(self, job: Job) -> Job:
        self._maybe_break("retry")
        return self._set(job, JobState.FAILED if job.attempts >= 3 else JobState.QUEUED, None)

    def progress(self, job: Job, fraction: float, text: str) -> None:
        self._maybe_break("progress")
        self.reports.append((job.id, fraction, text))

    def cancel(self, job_id: str) -> Job:
        with self.lock:
            self.jobs[job_id] = replace(self.jobs[job_id], state=JobState.CANCELLED)
            return self.jobs[job_id]

    def _set(self, job: Job, state: JobState, error: str | None) -> Job:
        with self.lock:
            self.jobs[job.id] = replace(self.jobs[job.id], state=state, error=error)
            return self.jobs[job.id]

    def _maybe_break(self, what: str) -> None:
        if self.break_next.get(what, 0):
            self.break_next[what] -= 1
            raise self.trouble(what)


@dataclass
class Submitted:
    spec: Any
    affinity: str
    on_progress: Progress | None
    future: Future[Any] = field(default_factory=Future)


class HandExecutor:
    """Keeps what is submitted until the test gives an answer."""

    def __init__(self) -> None:
        self.submitted: list[Submitted] = []

    def submit(
        self, task: Callable[..., Any], spec: Any, *, affinity: str = "", on_progress: Progress | None = None
    ) -> Future[Any]:
        self.submitted.append(Submitted(spec, affinity, on_progress))
        return self.submitted[-1].future

    def close(self) -> None:
        pass

    def specs(self) -> list[str]:
        return [item.spec for item in self.submitted]

    def of(self, job_id: str) -> Submitted:
        return [item for item in self.submitted if item.spec == job_id][-1]


class Ear:
    """Listener that writes down what it hears."""

    def __init__(self) -> None:
        self.finished: list[tuple[str, JobState]] = []

    def job_queued(self, job: Job) -> None:
        pass

    def job_finished(self, job: Job) -> None:
        self.finished.append((job.id, job.state))


def queued(job_id: str, order_key: str = "", kind: JobKind = JobKind.LOCATE_SEGMENT) -> Job:
    return make_job(job_id, JobState.QUEUED, kind=kind, order_key=order_key or job_id)
