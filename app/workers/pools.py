"""Executors inside the service process: inline and threads. (Processes: :mod:`app.workers.processes`.)"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from threading import Event
from typing import TypeVar

from app.engine.types import Progress
from app.workers.outcomes import TaskFuture, attempt, settle

Spec = TypeVar("Spec")
Result = TypeVar("Result")


class InlineExecutor:
    """Runs a task in the call of :meth:`submit`; for tests and debugging."""

    def __init__(self) -> None:
        self._closed = False

    @property
    def alive(self) -> int:
        """Workers that can take a task."""
        return 0 if self._closed else 1

    def start(self) -> None:
        """Do nothing; there is nothing to start."""

    def submit(
        self,
        task: Callable[[Spec, Progress], Result],
        spec: Spec,
        *,
        affinity: str = "",  # noqa: ARG002 - there is only one place to run
        on_progress: Progress | None = None,
    ) -> Future[Result]:
        """Run the task now."""
        if self._closed:
            raise RuntimeError("the executor is closed")
        future: Future[Result] = Future()
        future.set_running_or_notify_cancel()
        settle(future, attempt(task, spec, on_progress or _no_progress))
        return future

    def close(self) -> None:
        """Take no more tasks."""
        self._closed = True


class ThreadExecutor:
    """Runs tasks in threads. Kernels release the GIL, the rest of Python does not; a crash takes the service along."""

    def __init__(self, workers: int, *, warm_up: Callable[[], None] | None = None) -> None:
        self._pool = ThreadPoolExecutor(workers, thread_name_prefix="worker")
        self._workers = workers
        self._warm_up = warm_up
        self._warm: Future[None] | None = None
        self._closed = Event()

    @property
    def alive(self) -> int:
        """Workers that can take a task without compiling anything first."""
        cold = self._warm is not None and (not self._warm.done() or self._warm.exception() is not None)
        return 0 if self._closed.is_set() or cold else self._workers

    def start(self) -> None:
        """Warm up in the background; tasks are taken at once."""
        if self._warm_up is not None:
            self._warm = self._pool.submit(self._warm_up)

    def submit(
        self,
        task: Callable[[Spec, Progress], Result],
        spec: Spec,
        *,
        affinity: str = "",  # noqa: ARG002 - all threads share their maps
        on_progress: Progress | None = None,
    ) -> Future[Result]:
        """Queue the task, first come first served."""
        report, stopped = on_progress or _no_progress, Event()
        future: TaskFuture[Result] = TaskFuture(lambda _: stopped.set())

        def progress(fraction: float, text: str) -> None:
            # A thread cannot be stopped from outside; the next report of an unwanted task stops it from inside.
            if self._closed.is_set() or stopped.is_set():
                raise CancelledError("nobody waits for this task any more")
            report(fraction, text)

        def run() -> None:
            if future.set_running_or_notify_cancel():
                settle(future, attempt(task, spec, progress))

        self._pool.submit(run).add_done_callback(lambda place: _withdraw(future) if place.cancelled() else None)
        return future

    def close(self) -> None:
        """Cancel what waits; what runs ends at its next progress report, unwatched."""
        self._closed.set()
        self._pool.shutdown(wait=False, cancel_futures=True)


def _withdraw(future: Future[Result]) -> None:
    """The pool was closed before the task's turn came."""
    future.cancel()
    future.set_running_or_notify_cancel()


def _no_progress(_: float, __: str) -> None:
    pass
