"""Executor over worker processes: one pipe and one thread of the service a worker.

A worker that dies takes only its own task with it (:class:`WorkerLostError`) and is replaced at once. A pipe of our own
rather than ``ProcessPoolExecutor``: half the hand-over time, progress in band, and no lock shared between workers that
a killed one could keep.
"""

from __future__ import annotations

import atexit
import pickle
import sys
import threading
import time
from collections import OrderedDict, deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.connection import wait
from multiprocessing.context import BaseContext
from multiprocessing.process import BaseProcess
from types import ModuleType
from typing import Any, TypeVar

import structlog

from app.engine.types import Progress
from app.services.ports import WorkerLostError
from app.workers.outcomes import Done, Failed, TaskFuture, decode, settle
from app.workers.worker import Tag, worker_main

Spec = TypeVar("Spec")
Result = TypeVar("Result")

_AFFINITIES_KEPT = 32
_STOP_TIMEOUT_S = 5.0
_FIRST_DELAY_S = 0.1
_LONGEST_DELAY_S = 5.0

# The standard library's bookkeeping of child processes is not made for several threads.
_SPAWNING = threading.Lock()

_log = structlog.stdlib.get_logger(__name__)


@contextmanager
def _no_main_module() -> Iterator[None]:
    """Keep a new worker from importing the program that started the service (the whole command line, say).

    Tasks live in importable modules, so workers have no use for it, and it would cost every start half a second.
    """
    main = sys.modules["__main__"]
    sys.modules["__main__"] = ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = main


@dataclass(frozen=True, slots=True)
class _Ticket:
    """A submitted task."""

    payload: bytes
    affinity: str
    on_progress: Progress | None
    future: TaskFuture[Any]


class _Worker:
    """A running worker process and our end of its pipe."""

    def __init__(self, context: BaseContext, warm_up: bytes, name: str) -> None:
        self.connection, remote = context.Pipe()
        self.process: BaseProcess = context.Process(  # type: ignore[attr-defined]
            target=worker_main, args=(remote, warm_up), name=name, daemon=True
        )
        try:
            with _SPAWNING, _no_main_module():
                self.process.start()
        finally:
            remote.close()

    def await_ready(self, timeout_s: float) -> bool:
        """Wait until the worker has warmed up; False if it dies or takes too long."""
        try:
            return self.connection.poll(timeout_s) and self.connection.recv_bytes()[0] == Tag.READY
        except (EOFError, OSError):
            return False

    def call(self, ticket: _Ticket, time_limit_s: float | None) -> Done[Any] | Failed | None:
        """Run one task, fail with WorkerLostError if the worker dies over it or takes too long; None if cancelled."""
        if not ticket.future.set_running_or_notify_cancel():
            return None
        deadline = None if time_limit_s is None else time.monotonic() + time_limit_s
        try:
            self.connection.send_bytes(ticket.payload)
            while self.connection.poll(None if deadline is None else max(0.0, deadline - time.monotonic())):
                message = self.connection.recv_bytes()
                if message[0] == Tag.OUTCOME:
                    return decode(message[1:])
                if ticket.on_progress is not None:
                    ticket.on_progress(*pickle.loads(message[1:]))  # noqa: S301 - from our own worker
        except (EOFError, OSError):
            return Failed(WorkerLostError(f"worker {self.process.pid} died while it held the task"))
        return Failed(WorkerLostError(f"worker {self.process.pid} was stopped: it took longer than {time_limit_s} s"))

    def release(self, *, kill: bool) -> int | None:
        """Close the pipe, which asks an idle worker to leave, see it gone, and return its exit code."""
        self.connection.close()
        if not kill:
            self.process.join(_STOP_TIMEOUT_S)
        self.process.kill()
        self.process.join()
        exit_code = self.process.exitcode
        self.process.close()
        return exit_code


class _Slot:
    """A place for one worker; outlives the workers that fill it."""

    def __init__(self, index: int, context: BaseContext) -> None:
        self.index = index
        self.worker: _Worker | None = None
        self.warm = False
        self.assigned: _Ticket | None = None
        self.running: TaskFuture[Any] | None = None
        self.aborted = False
        self.recent: OrderedDict[str, None] = OrderedDict()
        self.bell, self._ring = context.Pipe(duplex=False)

    def ring(self) -> None:
        """Wake the slot's thread."""
        self._ring.send_bytes(b"!")

    def silence(self) -> None:
        """Forget all rings so far."""
        while self.bell.poll():
            self.bell.recv_bytes()

    def remember(self, affinity: str) -> None:
        """Note what the worker holds now."""
        self.recent[affinity] = None
        self.recent.move_to_end(affinity)
        while len(self.recent) > _AFFINITIES_KEPT:
            self.recent.popitem(last=False)

    def close(self) -> None:
        """Release the bell."""
        self.bell.close()
        self._ring.close()


class ProcessExecutor:
    """Runs tasks in worker processes.

    Parameters
    ----------
    workers : int
    context : BaseContext
        How processes are made; :func:`app.workers.bootstrap.worker_context` gives the service's.
    warm_up : callable
        Module-level function that every worker calls before its first task.
    time_limit_s : float or None
        A worker that takes longer over one task is killed.
    start_timeout_s : float
        A worker that takes longer to warm up is killed.
    on_lost : callable or None
        Called (from a thread of the pool) whenever a worker has died; must not raise.
    """

    def __init__(
        self,
        workers: int,
        context: BaseContext,
        *,
        warm_up: Callable[[], None],
        time_limit_s: float | None = None,
        start_timeout_s: float = 120.0,
        on_lost: Callable[[], None] | None = None,
    ) -> None:
        self._context = context
        self._warm_up = pickle.dumps(warm_up)
        self._time_limit_s = time_limit_s
        self._start_timeout_s = start_timeout_s
        self._on_lost = on_lost
        self._lock = threading.Lock()
        self._closed = threading.Event()
        self._pending: deque[_Ticket] = deque()
        self._idle: list[_Slot] = []
        self._slots = [_Slot(index, context) for index in range(workers)]
        self._threads = [
            threading.Thread(target=self._run_slot, args=(slot,), name=f"worker-slot-{slot.index}", daemon=True)
            for slot in self._slots
        ]

    @property
    def alive(self) -> int:
        """Workers that are warm."""
        with self._lock:
            return sum(slot.warm for slot in self._slots)

    @property
    def pids(self) -> tuple[int, ...]:
        """Process ids of the warm workers."""
        with self._lock:
            return tuple(slot.worker.process.pid or 0 for slot in self._slots if slot.worker and slot.warm)

    def start(self) -> None:
        """Start the workers; returns at once, tasks wait until a worker is warm."""
        # Else a service that ends on an error would wait for ever for workers that ignore its SIGTERM.
        atexit.register(self.close)
        for thread in self._threads:
            thread.start()

    def submit(
        self,
        task: Callable[[Spec, Progress], Result],
        spec: Spec,
        *,
        affinity: str = "",
        on_progress: Progress | None = None,
    ) -> Future[Result]:
        """Hand the task to an idle worker, at best one that had this affinity before, else queue it.

        ``on_progress`` and callbacks of the future run in a thread of the pool and must neither block nor raise.
        """
        payload = pickle.dumps((task, spec), protocol=pickle.HIGHEST_PROTOCOL)
        future: TaskFuture[Result] = TaskFuture(self._abort)
        with self._lock:
            if self._closed.is_set():
                raise RuntimeError("the executor is closed")
            self._pending.append(_Ticket(payload, affinity, on_progress, future))
            self._assign()
        return future

    def close(self) -> None:
        """Stop all workers now; running tasks are lost, waiting ones cancelled."""
        with self._lock:
            if self._closed.is_set():
                return
            self._closed.set()
            waiting = [*self._pending, *(slot.assigned for slot in self._slots if slot.assigned is not None)]
            self._pending.clear()
            for slot in self._slots:
                slot.assigned = None
                if slot.worker is not None and slot not in self._idle:
                    slot.worker.process.kill()
                slot.ring()
        for ticket in waiting:
            ticket.future.cancel()
            ticket.future.set_running_or_notify_cancel()
        for thread in self._threads:
            if thread.ident is not None:
                thread.join()
        for slot in self._slots:
            slot.close()
        atexit.unregister(self.close)

    def _assign(self) -> None:
        """Give waiting tasks to idle workers; under the lock."""
        while self._pending and self._idle:
            ticket = self._pending.popleft()
            slot = next((slot for slot in self._idle if ticket.affinity in slot.recent), self._idle[0])
            self._idle.remove(slot)
            slot.assigned = ticket
            slot.ring()

    def _run_slot(self, slot: _Slot) -> None:
        """Keep a worker in the slot until the pool is closed."""
        delay = _FIRST_DELAY_S
        while not self._closed.is_set():
            worker = self._spawn(slot)
            served = worker is not None and self._serve(slot, worker)
            if worker is not None:
                self._retire(slot, worker)
            # A worker that dies before it has served anything will probably do so again.
            delay = _FIRST_DELAY_S if served else min(2 * delay, _LONGEST_DELAY_S)
            if not served:
                self._closed.wait(delay)

    def _spawn(self, slot: _Slot) -> _Worker | None:
        """Start a worker and wait until it is warm; None if it cannot be had now."""
        try:
            worker = _Worker(self._context, self._warm_up, f"isodyn-worker-{slot.index}")
        except (OSError, EOFError) as error:
            _log.error("worker cannot be started", error=repr(error))
            return None
        with self._lock:
            slot.worker = worker
            if self._closed.is_set():
                return worker
        started = time.monotonic()
        warm = worker.await_ready(self._start_timeout_s)
        with self._lock:
            slot.warm, slot.aborted = warm, False
            slot.recent.clear()
        if warm:
            _log.debug("worker ready", pid=worker.process.pid, seconds=round(time.monotonic() - started, 3))
        return worker

    def _serve(self, slot: _Slot, worker: _Worker) -> bool:
        """Run tasks until the worker dies or the pool is closed; True if at least one was answered."""
        served = lost = False
        while slot.warm and not lost and (ticket := self._next(slot, worker)) is not None:
            with self._lock:
                slot.running = ticket.future
            outcome = worker.call(ticket, self._time_limit_s)
            with self._lock:
                slot.running = None
                slot.remember(ticket.affinity)
            lost = isinstance(outcome, Failed) and isinstance(outcome.error, WorkerLostError)
            served = served or not lost
            if outcome is not None:
                settle(ticket.future, outcome)
        return served or slot.aborted

    def _abort(self, future: TaskFuture[Any]) -> None:
        """End the worker that runs this task, if one still does."""
        with self._lock:
            for slot in self._slots:
                if slot.running is future and slot.worker is not None:
                    slot.aborted = True
                    slot.worker.process.kill()

    def _next(self, slot: _Slot, worker: _Worker) -> _Ticket | None:
        """Wait for a task; None if the pool is closed or the idle worker has died."""
        with self._lock:
            if self._closed.is_set():
                return None
            if self._pending:
                return self._pending.popleft()
            self._idle.append(slot)
        ready = wait([worker.connection, slot.bell])
        with self._lock:
            if slot in self._idle:
                self._idle.remove(slot)
            ticket, slot.assigned = slot.assigned, None
            slot.silence()
            if worker.connection not in ready or ticket is None:
                return ticket
            # It died just before it was given this task: another worker takes it, nothing was lost.
            self._pending.appendleft(ticket)
            self._assign()
            return None

    def _retire(self, slot: _Slot, worker: _Worker) -> None:
        """Clear the slot of a worker that died, never became warm, or is no longer wanted."""
        with self._lock:
            slot.worker, slot.warm = None, False
        closed = self._closed.is_set()
        pid = worker.process.pid
        exit_code = worker.release(kill=not closed)
        if slot.aborted:
            _log.info("worker stopped, its task was cancelled", pid=pid)
        elif not closed:
            _log.warning("worker lost", pid=pid, exit_code=exit_code)
            if self._on_lost is not None:
                self._on_lost()
