"""Whose turn it is: messages overtake one another, and some never come."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime, timedelta

from app.services.ingest.records import Stored

HOLD = timedelta(seconds=3)
HOLD_MESSAGES = 3
"""A message that is missing is waited for until so much time has passed, or so many later ones have come."""


def in_turn(waiting: Sequence[Stored], expected: int, now: datetime) -> tuple[tuple[Stored, ...], int]:
    """Messages whose turn it is, and the number that is expected after them.

    Parameters
    ----------
    waiting : sequence of Stored
        By number. Those below ``expected`` are late, and their turn is at once.
    expected : int
    now : datetime

    Returns
    -------
    tuple
        Messages by number; the number that comes next.
    """
    ready: list[Stored] = []
    for i, message in enumerate(waiting):
        if message.number > expected and not _given_up(waiting[i:], now):
            break
        ready.append(message)
        expected = max(expected, message.number + 1)
    return tuple(ready), expected


def _given_up(behind_gap: Sequence[Stored], now: datetime) -> bool:
    oldest = min(message.received_at for message in behind_gap)
    return len(behind_gap) >= HOLD_MESSAGES or now - oldest >= HOLD
