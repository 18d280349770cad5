"""Lets async endpoints await the end of a job that a worker thread reports."""

from __future__ import annotations

import asyncio
from collections import OrderedDict
from threading import Lock

from app.services.records import Job

_REMEMBERED = 4096


class JobBroker:
    """Listener that wakes whoever awaits a job.

    A job may finish between its acceptance and the call of :meth:`wait`; the last few thousand finished jobs are
    therefore remembered. Jobs that finished before the process started are not: look at the job's state first.
    """

    def __init__(self) -> None:
        self._lock = Lock()
        self._waiting: dict[str, list[asyncio.Future[Job]]] = {}
        self._finished: OrderedDict[str, Job] = OrderedDict()

    async def wait(self, job_id: str, timeout: float) -> Job | None:
        """Return the finished job, or None when ``timeout`` seconds pass first."""
        future: asyncio.Future[Job] = asyncio.get_running_loop().create_future()
        with self._lock:
            done = self._finished.get(job_id)
            if done is not None:
                return done
            self._waiting.setdefault(job_id, []).append(future)
        try:
            return await asyncio.wait_for(future, timeout)
        except TimeoutError:
            return None
        finally:
            self._forget(job_id, future)

    def job_queued(self, job: Job) -> None:
        """Ignore new work; the runner takes it."""

    def job_finished(self, job: Job) -> None:
        """Wake all who await this job; any thread may call."""
        with self._lock:
            self._finished[job.id] = job
            while len(self._finished) > _REMEMBERED:
                self._finished.popitem(last=False)
            waiting = self._waiting.pop(job.id, [])
        for future in waiting:
            loop = future.get_loop()
            if not loop.is_closed():
                loop.call_soon_threadsafe(_resolve, future, job)

    @property
    def waiting(self) -> int:
        """Number of jobs someone awaits."""
        with self._lock:
            return len(self._waiting)

    def _forget(self, job_id: str, future: asyncio.Future[Job]) -> None:
        with self._lock:
            futures = self._waiting.get(job_id, [])
            if future in futures:
                futures.remove(future)
            if not futures:
                self._waiting.pop(job_id, None)


def _resolve(future: asyncio.Future[Job], job: Job) -> None:
    if not future.done():
        future.set_result(job)
