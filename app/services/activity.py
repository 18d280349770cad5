"""Port: what the service did when, read within bounds. The adapter lives in ``app.storage``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import datetime
from typing import Protocol

from app.services.records import JobKind, LastingChange
from app.services.stats_records import (
    DiskUsage,
    Ended,
    Failure,
    Filters,
    FixCount,
    JobTimes,
    LastHeard,
    LevelRow,
    Read,
    SegmentCount,
    StorageRow,
    Waiting,
    Window,
)


class ActivityRepository(Protocol):
    """Questions about work done, each reading at most ``limit`` jobs of a kind: the newest of the window.

    Windows are by the time of acceptance. What a filter leaves out counts as read.
    """

    def segments(self, window: Window, filters: Filters, *, limit: int) -> Read[SegmentCount]:
        """Accepted segments, those of a bucket and state together."""
        ...

    def job_times(self, kind: JobKind, window: Window, filters: Filters, *, limit: int) -> Read[JobTimes]:
        """Jobs that are done or failed; those that were cancelled say nothing of the service."""
        ...

    def failures(self, kind: JobKind, window: Window, filters: Filters, *, limit: int) -> Read[Failure]:
        """Jobs that failed, newest first."""
        ...

    def ended(self, kind: JobKind, window: Window, filters: Filters, *, limit: int) -> Ended:
        """How many jobs ended how."""
        ...

    def fixes(self, window: Window, filters: Filters, *, limit: int) -> Read[FixCount]:
        """Fixes of accepted segments, alike ones of a bucket together."""
        ...

    def waiting(self) -> Sequence[Waiting]:
        """What is queued and running, by kind."""
        ...


class InventoryRepository(Protocol):
    """What is there now."""

    def storage(self) -> Sequence[StorageRow]:
        """Bytes of each group of tables, estimated."""
        ...

    def levels(
        self, window: Window, *, venue_id: str | None, level_id: str | None, cursor: str | None, limit: int
    ) -> Sequence[LevelRow]:
        """Levels, newest first, without their maps' ages."""
        ...

    def open_sessions(self, *, limit: int) -> Sequence[LastHeard]:
        """The newest open sessions, and when each was heard of last."""
        ...

    def quarantined(self, since: datetime) -> Mapping[str, int]:
        """Contributions of each level that were quarantined since."""
        ...

    def changes(self, since: datetime, *, limit: int) -> Sequence[LastingChange]:
        """Lasting changes found since, newest first."""
        ...


class Host(Protocol):
    """The machine and the workers of this process."""

    def disk(self) -> DiskUsage:
        """Bytes of the data folder, and what its disk has left."""
        ...

    def workers(self) -> tuple[int, int]:
        """Workers for segments that are ready, and how many there should be."""
        ...
