"""Sends what waits in the outbox, in a thread of its own: one message a webhook at a time, webhooks side by side."""

from __future__ import annotations

import asyncio
import contextlib
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractAsyncContextManager
from typing import Protocol, TypeVar

import structlog

from app.services.errors import OverloadedError
from app.services.records import Job, JobKind
from app.services.webhook_outbox import OutboxService
from app.services.webhook_records import Attempt, Delivery, DeliveryState, Webhook
from app.telemetry import Metrics

POLL_S = 1.0
"""How often the outbox is looked at although nobody said that something may be in it."""
LEAST_PAUSE_S = 0.05
"""Between two looks, however many jobs end."""
_STORING = 2
PRUNE_EVERY_S = 3600.0
MAX_IN_FLIGHT = 32
ERROR_PAUSE_S = 10.0
"""After an attempt whose outcome could not be stored: it is made again, but nobody is flooded."""
INTERNAL_ERROR = "internal error; the log of the service says more"

T = TypeVar("T")

_log = structlog.stdlib.get_logger(__name__)


class Sender(Protocol):
    """Sends one message."""

    async def send(self, webhook: Webhook, delivery: Delivery) -> Attempt:
        """Send a message and say what came of it."""
        ...


class WebhookDispatcher:
    """A thread with an event loop of its own; a job listener, for jobs that end may have something to tell.

    Parameters
    ----------
    outbox : OutboxService
    open_sender : callable
        Makes a sender, as a context of the loop.
    metrics : Metrics
    """

    def __init__(
        self, outbox: OutboxService, open_sender: Callable[[], AbstractAsyncContextManager[Sender]], metrics: Metrics
    ) -> None:
        self._outbox = outbox
        self._open_sender = open_sender
        self._metrics = metrics
        self._thread = threading.Thread(target=lambda: asyncio.run(self._run()), name="webhooks", daemon=True)
        self._ready = threading.Event()
        self._stopping = False
        self._loop: asyncio.AbstractEventLoop | None = None
        self._wake: asyncio.Event | None = None
        self._sending: dict[str, asyncio.Task[None]] = {}
        self._pruned_at = float("-inf")
        # of its own: a slow name server keeps the loop's threads busy
        self._storing = ThreadPoolExecutor(_STORING, thread_name_prefix="webhooks-outbox")

    def start(self) -> None:
        """Begin to send."""
        self._thread.start()
        self._ready.wait()

    def stop(self, grace_s: float) -> bool:
        """Send no more; wait for answers to what was sent, but not longer than this. False if the thread lives on.

        A message whose answer is not waited for stays pending, and is sent again after the next start.
        """
        if self._loop is None:
            return True
        with contextlib.suppress(RuntimeError):  # the loop has ended by itself
            self._loop.call_soon_threadsafe(self._end, grace_s)
        self._thread.join(grace_s + POLL_S)
        return not self._thread.is_alive()

    def wake(self) -> None:
        """There may be something to send; any thread may call."""
        if self._loop is not None and self._wake is not None:
            with contextlib.suppress(RuntimeError):  # stopped meanwhile
                self._loop.call_soon_threadsafe(self._wake.set)

    def job_queued(self, job: Job) -> None:
        """Do nothing: what is queued has nothing to tell yet."""

    def job_finished(self, job: Job) -> None:
        """Look whether the job left something to be told."""
        if job.kind is not JobKind.CONTRIBUTE:
            self.wake()

    # What follows runs in the dispatcher's thread.

    async def _run(self) -> None:
        self._loop, self._wake = asyncio.get_running_loop(), asyncio.Event()
        self._loop.set_default_executor(ThreadPoolExecutor(MAX_IN_FLIGHT, thread_name_prefix="webhooks-names"))
        self._ready.set()
        async with self._open_sender() as sender:
            while not self._stopping:
                self._wake.clear()
                # a task, so that an error is looked at as one of a sending task is
                looking = asyncio.create_task(self._look(sender))
                await asyncio.wait([looking])
                self._inspect(looking)
                await asyncio.sleep(LEAST_PAUSE_S)
                with contextlib.suppress(TimeoutError):
                    await asyncio.wait_for(self._wake.wait(), POLL_S)
            if self._sending:
                await asyncio.wait(self._sending.values())
        self._storing.shutdown()

    def _end(self, grace_s: float) -> None:
        self._stopping = True
        if self._wake is not None:
            self._wake.set()
        for task in self._sending.values():
            asyncio.get_running_loop().call_later(grace_s, task.cancel)

    async def _look(self, sender: Sender) -> None:
        """Begin to send what is due."""
        if time.monotonic() - self._pruned_at >= PRUNE_EVERY_S:
            self._pruned_at = time.monotonic()
            await self._store(self._outbox.prune)
        free = MAX_IN_FLIGHT - len(self._sending)
        if free <= 0:
            return
        busy = frozenset(self._sending)
        due = await self._store(lambda: self._outbox.due(without=busy, limit=free))
        for webhook, delivery in () if self._stopping else due:
            task = asyncio.create_task(self._deliver(sender, webhook, delivery))
            self._sending[webhook.id] = task
            task.add_done_callback(lambda done, id_=webhook.id: self._sent(id_, done))  # type: ignore[misc]

    async def _deliver(self, sender: Sender, webhook: Webhook, delivery: Delivery) -> None:
        started = time.perf_counter()
        sending = asyncio.create_task(sender.send(webhook, delivery))
        try:
            await asyncio.wait([sending])
        finally:
            sending.cancel()
        failed = self._inspect(sending)
        attempt = Attempt(None, INTERNAL_ERROR) if failed else sending.result()
        settled = await self._store(lambda: self._outbox.settle(delivery, attempt))
        outcome = "failed" if settled.state is DeliveryState.PENDING else settled.state.value
        self._metrics.webhook_attempts.labels(outcome).inc()
        self._metrics.webhook_seconds.observe(time.perf_counter() - started)
        if not attempt.succeeded:
            told = {"webhook": webhook.id, "delivery": delivery.id, "state": settled.state.value}
            _log.warning("webhook not reached", **told, attempts=settled.attempts, reason=attempt.error)

    def _sent(self, webhook_id: str, task: asyncio.Task[None]) -> None:
        """A webhook's turn is over: its next message may follow."""
        if task.cancelled() or not self._inspect(task) or self._loop is None:
            self._next(webhook_id)
        else:
            self._loop.call_later(ERROR_PAUSE_S, self._next, webhook_id)

    def _next(self, webhook_id: str) -> None:
        self._sending.pop(webhook_id, None)
        if self._wake is not None:
            self._wake.set()

    async def _store(self, work: Callable[[], T]) -> T:
        return await asyncio.get_running_loop().run_in_executor(self._storing, work)

    def _inspect(self, task: asyncio.Task[object] | asyncio.Task[None] | asyncio.Task[Attempt]) -> bool:
        """Whether a task met an error. None ends the thread: it is logged, counted, and done again later."""
        error = task.exception()
        if error is None:
            return False
        self._metrics.webhook_errors.inc()
        if isinstance(error, OverloadedError):
            _log.warning("webhooks wait", reason=str(error))
        else:
            _log.error("webhooks met an unexpected error", exc_info=error)
        return True
