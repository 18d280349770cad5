"""Fan-out of job events: services tell one listener, several parts of the process hear it."""

from __future__ import annotations

from app.services.ports import JobListener
from app.services.records import Job


class JobEvents:
    """A listener that passes every event on to the listeners added to it, in order.

    The composition root makes it first (services need a listener) and adds runner, broker and metrics later.
    Listeners are added before the service starts and must neither block nor raise.
    """

    def __init__(self) -> None:
        self._listeners: tuple[JobListener, ...] = ()

    def add(self, listener: JobListener) -> None:
        """Also tell ``listener``."""
        self._listeners = (*self._listeners, listener)

    def job_queued(self, job: Job) -> None:
        """Pass on that there is new work."""
        for listener in self._listeners:
            listener.job_queued(job)

    def job_finished(self, job: Job) -> None:
        """Pass on that a job reached a final state."""
        for listener in self._listeners:
            listener.job_finished(job)
