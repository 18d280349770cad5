"""What all use cases share: the unit of work, the clock, and checks of page parameters."""

from __future__ import annotations

from app.services.clock import Clock
from app.services.errors import InvalidError
from app.services.ports import UnitOfWorkFactory

MAX_LIMIT = 500
DEFAULT_LIMIT = 100


class Service:
    """Base of the use cases: one call, one transaction; safe to call from several threads."""

    def __init__(self, *, uow: UnitOfWorkFactory, clock: Clock) -> None:
        self._uow = uow
        self._clock = clock


def check_limit(limit: int) -> int:
    """Return ``limit`` if it is a page size that lists accept."""
    if not 1 <= limit <= MAX_LIMIT:
        raise InvalidError("limit", f"{limit} is out of range", f"give 1 to {MAX_LIMIT}")
    return limit


def check_number_cursor(cursor: str | None) -> str | None:
    """Return ``cursor`` if it is one of a list numbered by integers."""
    if cursor is not None and not (cursor.isascii() and cursor.isdigit() and len(cursor) <= 18):
        raise InvalidError("cursor", f"{cursor!r} is not a cursor of this list", "give next_cursor of the page before")
    return cursor
