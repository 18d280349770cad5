"""Feeds executors from the durable queue and stores what comes back.

Each kind of job has a lane of its own: a thread that claims jobs, prepares their specs, submits them, and completes
each in its own transaction. A map build, which takes seconds in every step, therefore never holds up a segment.
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from queue import Empty, SimpleQueue
from typing import Any, Generic, Protocol, TypeVar

import structlog

from app.engine.errors import EngineError
from app.engine.types import Progress
from app.services.errors import ConflictError, InvalidError, NotFoundError, OverloadedError
from app.services.ports import Executor, JobListener, WorkerLostError
from app.services.records import Job, JobKind, JobState
from app.telemetry import Metrics

Spec = TypeVar("Spec")
Result = TypeVar("Result")

POLL_S = 2.0
"""Safety net: how often the queue is looked at although nobody said that there is work."""
PROGRESS_EVERY_S = 0.25
MAX_TRIES = 3
"""How often a step that meets an unexpected error is tried before its job is failed."""
MAX_PAUSE_S = 30.0
"""Longest pause between two tries of a step that waits for the database."""
INTERNAL_ERROR = "internal error; the log of the service says more"

# Whoever cancels a job tells so itself.
_TOLD_HERE = frozenset({JobState.DONE, JobState.FAILED})

_log = structlog.stdlib.get_logger(__name__)


class Processing(Protocol):
    """What a lane needs of :class:`app.services.processing.ProcessingService` besides spec and completion."""

    def claim(self, limit: int, kind: JobKind | None = None) -> Sequence[Job]:
        """Take jobs to run now."""
        ...

    def fail(self, job: Job, error: str) -> Job:
        """Give a job up."""
        ...

    def retry(self, job: Job) -> Job:
        """Queue a job again whose worker was lost, or give it up."""
        ...

    def progress(self, job: Job, fraction: float, text: str) -> None:
        """Show how far a job is."""
        ...


@dataclass(frozen=True, slots=True)
class Work(Generic[Spec, Result]):
    """How jobs of one kind are done: prepare a spec, run the task on it, complete the job with the result."""

    kind: JobKind
    executor: Executor
    capacity: int
    """Jobs with the executor at a time; more than workers, so that none waits for the lane."""
    task: Callable[[Spec, Progress], Result]
    prepare: Callable[[Job], Spec]
    complete: Callable[[Job, Result], Job | None]
    """Returns the finished job, or None if the result came too late to count."""
    affinity: Callable[[Spec], str]
    shows_progress: bool = False


@dataclass(slots=True)
class _Step:
    """Something to do for a job, and how often that was tried."""

    job: Job
    run: Callable[[], None]
    tries: int = 0
    pauses: int = 0
    not_before: float = 0.0


class Lane(Generic[Spec, Result]):
    """One thread that does the jobs of one kind, segments of a session in order.

    It holds the one place of the service process where any exception is caught: it is logged, the step is tried again,
    and in the end its job is failed, so that one bad job never stops the queue.
    """

    def __init__(
        self, work: Work[Spec, Result], *, processing: Processing, listener: JobListener, metrics: Metrics
    ) -> None:
        self._work = work
        self._processing = processing
        self._listener = listener
        self._metrics = metrics
        self._inbox: SimpleQueue[_Step | None] = SimpleQueue()
        self._again: deque[_Step] = deque()
        self._waiting = 0
        self._look = False
        self._unsure = True
        self._in_flight: dict[str, Future[Result] | None] = {}
        self._cancelled: set[str] = set()
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"lane-{work.kind}", daemon=True)

    def start(self) -> None:
        """Begin to take jobs."""
        self._thread.start()

    def wake(self) -> None:
        """There may be new work; any thread may call."""
        self._inbox.put(None)

    def cancel(self, job: Job) -> None:
        """The job was cancelled: withdraw it from the executor, if it is there; any thread may call."""
        self._inbox.put(_Step(job, lambda: self._withdraw(job)))

    def stop(self) -> None:
        """Take no more jobs; the thread ends when those with the executor are done."""
        self._stopping.set()
        self.wake()

    def join(self, timeout_s: float) -> bool:
        """Wait for the thread to end; False if it has not."""
        if self._thread.ident is not None:
            self._thread.join(timeout_s)
        return not self._thread.is_alive()

    # What follows runs in the lane's thread.

    def _run(self) -> None:
        while not (self._stopping.is_set() and not self._in_flight):
            with contextlib.suppress(OverloadedError):  # the next look at the queue is another try
                self._guard(None, self._fill)
            for step in self._next_steps():
                self._take(step)

    def _next_steps(self) -> list[_Step]:
        """Wait until something happens and return what is to be done about it."""
        events: list[_Step | None] = []
        try:
            events.append(self._inbox.get(timeout=POLL_S))
            while True:
                events.append(self._inbox.get_nowait())
        except Empty:
            now = time.monotonic()
            due = [step for step in self._again if step.not_before <= now]
            self._again = deque(step for step in self._again if step.not_before > now)
        wakes = events.count(None)
        self._waiting += wakes
        self._look = self._look or wakes > 0 or not events
        return [*due, *(event for event in events if event is not None)]

    def _fill(self) -> None:
        """Claim as many jobs as the executor should have, if there can be any.

        A claim is a transaction, so none is made in vain after every job: ``_waiting`` counts the jobs announced and
        not yet claimed (sessions that have one running hold theirs back). Jobs from before the start were not
        announced, and cancelled ones are counted still, until the queue is found empty.
        """
        free = self._work.capacity - len(self._in_flight)
        wanted = self._look or self._unsure or self._waiting > 0
        if free <= 0 or not wanted or self._stopping.is_set():
            return
        claimed = self._processing.claim(free, self._work.kind)
        self._look = False
        self._waiting -= len(claimed)
        if not claimed and not self._in_flight:
            self._waiting, self._unsure = 0, False
        for job in claimed:
            self._in_flight[job.id] = None
            self._take(_Step(job, lambda job=job: self._launch(job)))  # type: ignore[misc]
        self._metrics.jobs_running.labels(self._work.kind).set(len(self._in_flight))

    def _take(self, step: _Step) -> None:
        """Do a step; one that meets an unexpected error is done again later, in the end the job is failed instead.

        Trouble with the database is not the job's: such a step waits for it to pass, however long that takes.
        """
        try:
            done = self._guard(step.job, step.run)
        except OverloadedError:
            step.pauses += 1
            step.not_before = time.monotonic() + min(POLL_S * 2.0 ** min(step.pauses - 1, 10), MAX_PAUSE_S)
            self._again.append(step)
            return
        step.tries += 1
        if done:
            return
        if step.tries == MAX_TRIES:
            step.run = lambda: self._end(self._processing.fail(step.job, INTERNAL_ERROR))
        if step.tries < 2 * MAX_TRIES:
            step.not_before = time.monotonic() + POLL_S
            self._again.append(step)
        else:
            # Not even its failure can be stored: it stays marked as running and is queued again at the next start.
            self._land(step.job)

    def _guard(self, job: Job | None, action: Callable[[], None]) -> bool:
        try:
            action()
        except OverloadedError as error:
            self._metrics.runner_errors.inc()
            _log.warning("waiting", kind=self._work.kind, job=None if job is None else job.id, reason=str(error))
            raise
        except Exception:  # noqa: BLE001 - the service's boundary: logged, counted, and the job is failed in the end
            self._metrics.runner_errors.inc()
            _log.exception("unexpected error", kind=self._work.kind, job=None if job is None else job.id)
            return False
        return True

    def _launch(self, job: Job) -> None:
        """Hand a claimed job to the executor."""
        try:
            spec = self._work.prepare(job)
        except (EngineError, InvalidError, NotFoundError, ConflictError) as error:
            self._end(self._processing.fail(job, str(error)))
            return
        future = self._work.executor.submit(
            self._work.task,
            spec,
            affinity=self._work.affinity(spec),
            on_progress=self._reporter(job) if self._work.shows_progress else None,
        )
        self._in_flight[job.id] = future
        future.add_done_callback(lambda done: self._inbox.put(_Step(job, lambda: self._finish(job, done))))

    def _finish(self, job: Job, future: Future[Result]) -> None:
        """Store what came of a job."""
        if future.cancelled() or job.id in self._cancelled:
            self._land(job)
            return
        error = future.exception()
        if self._stopping.is_set() and isinstance(error, WorkerLostError):
            # Abandoned: it stays marked as running, for the next start to find.
            self._land(job)
            return
        if error is None:
            self._end_or_land(job, self._work.complete(job, future.result()))
        elif isinstance(error, WorkerLostError):
            self._metrics.jobs_retried.labels(self._work.kind).inc()
            self._end(self._processing.retry(job))
        elif isinstance(error, EngineError):
            self._end(self._processing.fail(job, str(error)))
        else:
            self._metrics.runner_errors.inc()
            _log.error("task failed", kind=self._work.kind, job=job.id, exc_info=error)
            self._end(self._processing.fail(job, INTERNAL_ERROR))

    def _end_or_land(self, job: Job, ended: Job | None) -> None:
        if ended is None:
            self._land(job)
        else:
            self._end(ended)

    def _end(self, job: Job) -> None:
        """The job left the executor and its new state is stored: tell, if that is final."""
        self._land(job)
        if job.state in _TOLD_HERE:
            self._listener.job_finished(job)
        elif job.state is JobState.QUEUED:
            self._waiting += 1

    def _land(self, job: Job) -> None:
        self._in_flight.pop(job.id, None)
        self._cancelled.discard(job.id)
        self._metrics.jobs_running.labels(self._work.kind).set(len(self._in_flight))

    def _withdraw(self, job: Job) -> None:
        future = self._in_flight.get(job.id)
        if future is not None:
            self._cancelled.add(job.id)
            future.cancel()

    def _reporter(self, job: Job) -> Progress:
        """Progress callback for a worker: passes a report on to the lane, not too often."""
        posted_at = float("-inf")

        def report(fraction: float, text: str) -> None:
            nonlocal posted_at
            now = time.monotonic()
            if now - posted_at >= PROGRESS_EVERY_S:
                posted_at = now
                self._inbox.put(_Step(job, lambda: self._show(job, fraction, text)))

        return report

    def _show(self, job: Job, fraction: float, text: str) -> None:
        # A report that cannot be stored is not worth a second try, let alone the job.
        if job.id in self._in_flight:
            with contextlib.suppress(OverloadedError):
                self._guard(job, lambda: self._processing.progress(job, fraction, text))


class JobRunner:
    """All lanes of the service; a job listener that wakes the lane concerned."""

    def __init__(self, lanes: dict[JobKind, Lane[Any, Any]]) -> None:
        self._lanes = lanes

    def start(self) -> None:
        """Begin to take jobs."""
        for lane in self._lanes.values():
            lane.start()

    def job_queued(self, job: Job) -> None:
        """Wake the lane of the job's kind."""
        self._lanes[job.kind].wake()

    def job_finished(self, job: Job) -> None:
        """Withdraw a job that was cancelled."""
        if job.state is JobState.CANCELLED:
            self._lanes[job.kind].cancel(job)

    def stop(self, grace_s: float) -> bool:
        """Take no more jobs and wait for those that run; False if some must be abandoned.

        What is abandoned stays marked as running; :meth:`ProcessingService.recover` queues it at the next start.
        """
        for lane in self._lanes.values():
            lane.stop()
        return self.join(grace_s)

    def join(self, timeout_s: float) -> bool:
        """Wait for all lanes to end; False if one has not."""
        deadline = time.monotonic() + timeout_s
        ended = [lane.join(max(0.0, deadline - time.monotonic())) for lane in self._lanes.values()]
        return all(ended)
