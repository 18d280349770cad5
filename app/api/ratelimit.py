"""Rate limit per key: the generic cell rate algorithm (ITU-T I.371, annex A), one float of state a key."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from threading import Lock

_PRUNE_ABOVE = 10_000


@dataclass(frozen=True, slots=True)
class Quota:
    """Answer to one request: allowed or not, and what is left."""

    allowed: bool
    remaining: int
    retry_after_s: int
    """Whole seconds until a request is allowed again; 0 if this one was."""
    reset_s: int
    """Whole seconds until the full burst is there again."""


class RateLimiter:
    """Allows ``per_minute`` requests in the long run and ``burst`` at once, for each name on its own.

    The state of a name is its theoretical arrival time: when the next request would come if all came evenly. A
    request that is more than the burst's worth ahead of it is refused and leaves no trace.
    """

    def __init__(self, per_minute: int, burst: int, clock: Callable[[], float] = time.monotonic) -> None:
        self.per_minute = per_minute
        self.burst = burst
        self._interval = 60.0 / per_minute if per_minute else 0.0
        self._tolerance = self._interval * burst
        self._clock = clock
        self._arrival: dict[str, float] = {}
        self._lock = Lock()

    @property
    def policy(self) -> str:
        """Value of the ``RateLimit-Policy`` header."""
        return f'"key";q={self.per_minute};w=60'

    def take(self, name: str) -> Quota | None:
        """Count one request; None where there is no limit."""
        if not self.per_minute:
            return None
        now = self._clock()
        with self._lock:
            arrival = max(self._arrival.get(name, now), now) + self._interval
            wait = arrival - now - self._tolerance
            # A rounding error of the clock must not refuse the last request of a burst.
            allowed = wait <= 1e-9 * max(1.0, now)
            if allowed:
                self._arrival[name] = arrival
                self._prune(now)
            else:
                arrival -= self._interval
        ahead = arrival - now
        return Quota(
            allowed=allowed,
            remaining=max(0, int((self._tolerance - ahead) / self._interval + 1e-6)),
            retry_after_s=0 if allowed else max(1, math.ceil(wait)),
            reset_s=math.ceil(ahead - 1e-6),
        )

    def _prune(self, now: float) -> None:
        if len(self._arrival) > _PRUNE_ABOVE:
            self._arrival = {name: arrival for name, arrival in self._arrival.items() if arrival > now}
