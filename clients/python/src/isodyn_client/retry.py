"""When a request is sent again, and after how long."""

from __future__ import annotations

import random
from dataclasses import dataclass
from datetime import UTC, datetime
from email.utils import parsedate_to_datetime

import httpx

_REFUSED_UNDONE = frozenset({429, 503})
"""Statuses by which the service says that it has done nothing: any request may come again."""
_PASSING = frozenset({408, 429, 500, 502, 503, 504})
"""Statuses that may pass by themselves."""
_NOT_SENT = (httpx.ConnectError, httpx.ConnectTimeout, httpx.PoolTimeout)
"""Failures that happen before the first byte of a request leaves."""


@dataclass(frozen=True, slots=True)
class RetryPolicy:
    """Exponential back-off with jitter.

    The pause before retry ``k`` (0, 1, ...) is drawn evenly from the upper half of
    ``min(max_pause_s, base_s * 2**k)``. A ``Retry-After`` of the service replaces it; one longer than
    ``max_retry_after_s`` ends the retries, so that the caller hears of it instead of hanging.

    Parameters
    ----------
    retries : int
        How often to try again after the first attempt; 0 switches retries off.
    base_s, max_pause_s : float, s
    max_retry_after_s : float, s
    """

    retries: int = 4
    base_s: float = 0.25
    max_pause_s: float = 8.0
    max_retry_after_s: float = 60.0

    def after_failure(self, attempt: int, *, repeatable: bool, error: httpx.TransportError) -> bool:
        """Whether to try again after no answer came to ``attempt`` (0, 1, ...)."""
        return attempt < self.retries and (repeatable or isinstance(error, _NOT_SENT))

    def after_answer(self, attempt: int, *, repeatable: bool, status: int, retry_after_s: float | None) -> bool:
        """Whether to try again after an answer that is not a success."""
        if attempt >= self.retries or (retry_after_s or 0.0) > self.max_retry_after_s:
            return False
        return status in (_PASSING if repeatable else _REFUSED_UNDONE)

    def pause_s(self, attempt: int, rng: random.Random, retry_after_s: float | None = None) -> float:
        """Seconds to wait before trying again."""
        if retry_after_s is not None:
            return retry_after_s
        longest = min(self.max_pause_s, self.base_s * 2.0**attempt)
        return longest * rng.uniform(0.5, 1.0)


def retry_after(response: httpx.Response, now: datetime | None = None) -> float | None:
    """Seconds from a ``Retry-After`` header, which holds seconds or a date; None without one."""
    value = response.headers.get("Retry-After", "").strip()
    if not value:
        return None
    if value.isdigit():
        return float(value)
    try:
        when = parsedate_to_datetime(value)
    except ValueError:
        return None
    if when.tzinfo is None:
        when = when.replace(tzinfo=UTC)
    return max(0.0, (when - (now or datetime.now(UTC))).total_seconds())
