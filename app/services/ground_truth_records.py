"""Known positions of sessions, what was told there, and the repository that keeps both."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Protocol

from app.engine.localization.marks import Mark, MarkMatch
from app.engine.types import Fix
from app.services.records import Page
from app.services.stats_records import Filters, Window


@dataclass(frozen=True, slots=True)
class TruthPoint:
    """A known position of a session, and what was told there.

    ``match`` is None while no fix lies near, and for good once ``settled``: then no later fix can come nearer.
    """

    session_id: str
    number: int
    mark: Mark
    created_at: datetime
    settled: bool
    match: MarkMatch | None


@dataclass(frozen=True, slots=True)
class Judged:
    """One matched point with what statistics group it by; ``level_id`` is the fix's."""

    t: float
    level_id: str
    device_id: str | None
    method: str
    error_m: float
    inside: bool
    sure: bool


class GroundTruthRepository(Protocol):
    """Known positions of sessions."""

    def add(self, session_id: str, marks: Sequence[Mark], now: datetime) -> Sequence[int]:
        """Store points and return their numbers; one of the same time as a stored point takes its place."""
        ...

    def count(self, session_id: str) -> int:
        """How many points a session has."""
        ...

    def get(self, session_id: str, numbers: Sequence[int]) -> Sequence[TruthPoint]:
        """The points of these numbers, which follow one another."""
        ...

    def list(self, session_id: str, *, cursor: str | None, limit: int) -> Page[TruthPoint]:
        """Points of a session in the order in which they were stored; the cursor is the last ``number`` seen."""
        ...

    def delete(self, session_id: str) -> None:
        """Forget all points of a session."""
        ...

    def unsettled(self, session_id: str, *, limit: int) -> Sequence[TruthPoint]:
        """Points that a later fix may still come nearer to."""
        ...

    def fixes_between(self, session_id: str, t_first: float, t_last: float) -> Sequence[Fix]:
        """Filtered fixes of these times (UTC seconds, both ends in), in time order, without their hypotheses."""
        ...

    def last_fix_t(self, session_id: str) -> float | None:
        """Time of the session's newest filtered fix, UTC seconds."""
        ...

    def settle(self, points: Sequence[TruthPoint]) -> None:
        """Store ``match`` and ``settled`` of these points."""
        ...

    def judged(self, window: Window, filters: Filters, *, limit: int) -> Sequence[Judged]:
        """Matched points whose time lies in the window, newest first."""
        ...
