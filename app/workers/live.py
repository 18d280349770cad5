"""Lets async endpoints follow sessions: who watches is told that something changed, and reads it from the database.

A notice carries no data. The database is what was said, in order and with numbers, so a watcher that missed a notice
(or was cut off for an hour) reads on from the last number it has: nothing is lost and nothing comes twice.
"""

from __future__ import annotations

import asyncio
from threading import RLock

from app.services.records import Job


class SessionWatch:
    """One watcher's notices; used in the event loop in which it was made."""

    def __init__(self, hub: SessionHub, session_id: str | None) -> None:
        self._hub = hub
        self._session_id = session_id
        self._loop = asyncio.get_running_loop()
        self._changed: set[str] = set()
        self._event = asyncio.Event()
        self.closed = False
        """Whether the service is about to stop: say goodbye and end."""

    async def wait(self, timeout: float) -> frozenset[str]:
        """Ids of the sessions that changed since the last call; empty after ``timeout`` seconds, or when closed."""
        try:
            await asyncio.wait_for(self._event.wait(), timeout)
        except TimeoutError:
            return frozenset()
        changed = frozenset(self._changed)
        self._changed.clear()
        if not self.closed:
            self._event.clear()
        return changed

    def cancel(self) -> None:
        """Watch no longer."""
        self._hub.forget(self, self._session_id)

    def notify(self, session_id: str | None) -> None:
        """Note that a session changed (None: that the service stops); any thread may call."""
        if not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self._note, session_id)

    def _note(self, session_id: str | None) -> None:
        if session_id is None:
            self.closed = True
        else:
            self._changed.add(session_id)
        self._event.set()


class SessionHub:
    """Tells watchers about their session, or about all: a job listener, and told by services of closed sessions."""

    def __init__(self) -> None:
        # re-entrant: close is called by a signal handler, which may interrupt a thread that holds it
        self._lock = RLock()
        self._of_session: dict[str, list[SessionWatch]] = {}
        self._of_all: list[SessionWatch] = []
        self._closed = False

    def watch(self, session_id: str | None = None) -> SessionWatch:
        """Begin to watch one session, or all of them; whatever changes from now on is told."""
        watch = SessionWatch(self, session_id)
        with self._lock:
            self._list_of(session_id).append(watch)
            closed = self._closed
        if closed:
            watch.notify(None)
        return watch

    def forget(self, watch: SessionWatch, session_id: str | None) -> None:
        """Tell this watcher nothing more."""
        with self._lock:
            watches = self._list_of(session_id)
            if watch in watches:
                watches.remove(watch)
            if session_id is not None and not watches:
                self._of_session.pop(session_id, None)

    def session_changed(self, session_id: str) -> None:
        """A session was opened or closed, or has new fixes; any thread may call."""
        with self._lock:
            watches = (*self._of_session.get(session_id, ()), *self._of_all)
        for watch in watches:
            watch.notify(session_id)

    def job_queued(self, job: Job) -> None:
        """Ignore new work: it changes no position yet."""

    def job_finished(self, job: Job) -> None:
        """Tell of the fixes of a finished segment, or that the last job of a session is done."""
        session_id = job.subject.get("session_id")
        if session_id is not None:
            self.session_changed(str(session_id))

    def close(self) -> None:
        """End all watches: the service stops, and open streams would hold that up."""
        with self._lock:
            self._closed = True
            watches = [*self._of_all, *(watch for group in self._of_session.values() for watch in group)]
        for watch in watches:
            watch.notify(None)

    @property
    def watching(self) -> int:
        """Number of watchers."""
        with self._lock:
            return len(self._of_all) + sum(map(len, self._of_session.values()))

    def _list_of(self, session_id: str | None) -> list[SessionWatch]:
        return self._of_all if session_id is None else self._of_session.setdefault(session_id, [])
