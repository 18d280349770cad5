"""What the API needs from its process: settings, metrics, and a broker for finished jobs. Adapters live elsewhere."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Protocol

from app.services.records import Job


class ApiSettings(Protocol):
    """What an operator may choose about the HTTP side (``app.settings.Settings`` has all of it)."""

    @property
    def max_body_bytes(self) -> int:
        """Largest body as sent; a compressed one may inflate to :data:`app.api.body.INFLATE_RATIO` times this."""
        ...

    @property
    def max_wait_s(self) -> float:
        """Longest ``Prefer: wait=N`` that is honoured."""
        ...

    @property
    def rate_limit_per_minute(self) -> int:
        """Requests one key may make in the long run; 0: no limit."""
        ...

    @property
    def rate_limit_burst(self) -> int:
        """Requests one key may make at once."""
        ...

    @property
    def max_streams(self) -> int:
        """Streams (WebSocket, server-sent events) open at once."""
        ...

    @property
    def cors_origins(self) -> tuple[str, ...]:
        """Browser origins that may call; empty: none."""
        ...


class Broker(Protocol):
    """Lets a request wait for the end of a job."""

    async def wait(self, job_id: str, timeout: float) -> Job | None:
        """Return the job once it is final, at once if it ended before the call; None after ``timeout`` seconds."""
        ...


class Watch(Protocol):
    """Notices about sessions, for one watcher."""

    closed: bool
    """Whether the service is about to stop."""

    async def wait(self, timeout: float) -> frozenset[str]:
        """Return the ids of the sessions that changed since the last call; empty after ``timeout`` seconds."""
        ...

    def cancel(self) -> None:
        """Watch no longer."""
        ...


class Hub(Protocol):
    """Lets streams follow sessions."""

    @property
    def watching(self) -> int:
        """Number of watchers."""
        ...

    def watch(self, session_id: str | None = None) -> Watch:
        """Begin to watch one session, or all of them."""
        ...


class Metrics(Protocol):
    """Counts requests and shows the figures."""

    def observe_request(self, method: str, route: str, status: int, seconds: float) -> None:
        """Count one answer; ``route`` is the path template, or ``unmatched``."""
        ...

    def render(self) -> bytes:
        """Return all metrics in the Prometheus text format."""
        ...


Readiness = Callable[[], Mapping[str, bool]]
"""Names of what must work before requests are taken, and whether each does; may block briefly."""
