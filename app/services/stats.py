"""Counts, rates, delays and errors for operators.

Every question is bounded: a window holds at most :data:`MAX_BUCKETS` buckets, and at most so many jobs of a kind are
read as the constants below say, the newest; an answer that had to leave some out says since when it is complete.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from datetime import datetime, timedelta

from app.services.activity import Host
from app.services.base import DEFAULT_LIMIT, Service, check_limit
from app.services.clock import Clock
from app.services.errors import InvalidError
from app.services.ports import UnitOfWorkFactory
from app.services.records import JobKind, Page, Stats
from app.services.stats_records import (
    NO_FILTERS,
    AccuracyRow,
    BacklogRow,
    Bucket,
    ErrorRow,
    Filters,
    FixRow,
    GroupBy,
    LatencyRow,
    LevelRow,
    StorageRow,
    Table,
    ThroughputRow,
    Window,
)
from app.services.stats_tables import (
    accuracy_rows,
    backlog_rows,
    error_rows,
    fix_rows,
    latency_rows,
    throughput_rows,
)

MAX_BUCKETS = 1500
MAX_JOBS = 200_000
"""Jobs of a kind that one question counts; the database does that, some microseconds each."""
MAX_TIMES = 50_000
"""Jobs of a kind of which one question about delays reads the times: about a second."""
MAX_FIX_SEGMENTS = 20_000
"""Segments whose fixes one question counts."""
MAX_POINTS = 50_000
"""Known positions that one question about accuracy reads."""
_DEFAULT_SPAN = {
    None: timedelta(days=1),
    Bucket.MINUTE: timedelta(hours=1),
    Bucket.HOUR: timedelta(days=1),
    Bucket.DAY: timedelta(days=30),
}


class StatsService(Service):
    """What operators ask; nothing here writes."""

    def __init__(self, *, uow: UnitOfWorkFactory, clock: Clock, host: Host | None = None) -> None:
        super().__init__(uow=uow, clock=clock)
        self._host = host

    def stats(self) -> Stats:
        """Counts as of now."""
        with self._uow() as uow:
            return uow.stats()

    def window(self, since: datetime | None, until: datetime | None, bucket: Bucket | None) -> Window:
        """The window that is asked for; by default it ends now and has a length that fits the bucket."""
        now = self._clock()
        until = until or now
        since = since or until - _DEFAULT_SPAN[bucket]
        if since >= until:
            raise InvalidError("since", "is not before until", "send since < until")
        if bucket is not None and (until - since) / bucket.length > MAX_BUCKETS:
            raise InvalidError(
                "bucket",
                f"{bucket} gives more than {MAX_BUCKETS} buckets between since and until",
                "send a longer bucket or a shorter time",
            )
        return Window(since, until, bucket, open_end=until >= now)

    def throughput(self, window: Window, filters: Filters = NO_FILTERS) -> Table[ThroughputRow]:
        """Segments, samples and fixes, one row a bucket."""
        with self._uow() as uow:
            found = uow.activity.segments(window, filters, limit=MAX_JOBS)
        return Table(window, throughput_rows(window, found.rows), found.complete_since)

    def latency(self, window: Window, filters: Filters = NO_FILTERS) -> Table[LatencyRow]:
        """Percentiles of queue wait, processing and both together, by kind."""
        with self._uow() as uow:
            found = [uow.activity.job_times(kind, window, filters, limit=MAX_TIMES) for kind in JobKind]
        rows = latency_rows(window, (one for read in found for one in read.rows))
        return Table(window, rows, _latest(read.complete_since for read in found))

    def backlog(self) -> tuple[BacklogRow, ...]:
        """What waits and runs now, by kind."""
        with self._uow() as uow:
            return backlog_rows(uow.activity.waiting(), self._clock())

    def errors(self, window: Window, filters: Filters = NO_FILTERS) -> Table[ErrorRow]:
        """Failures by kind and sort of text."""
        with self._uow() as uow:
            found = [uow.activity.failures(kind, window, filters, limit=MAX_JOBS) for kind in JobKind]
            ended = [uow.activity.ended(kind, window, filters, limit=MAX_JOBS) for kind in JobKind]
        n_ended = {one.kind: one.n_done + one.n_failed for one in ended}
        rows = error_rows([one for read in found for one in read.rows], n_ended)
        return Table(window, rows, _latest(read.complete_since for read in found))

    def fixes(self, window: Window, filters: Filters = NO_FILTERS, by: Sequence[GroupBy] = ()) -> Table[FixRow]:
        """Fixes by what they claim."""
        with self._uow() as uow:
            found = uow.activity.fixes(window, filters, limit=MAX_FIX_SEGMENTS)
        return Table(window, fix_rows(window, found.rows, by), found.complete_since)

    def accuracy(self, window: Window, filters: Filters = NO_FILTERS, by: Sequence[GroupBy] = ()) -> Table[AccuracyRow]:
        """Errors at known positions, and how often the 95 % ellipse held them; windows are by the points' own time."""
        with self._uow() as uow:
            found = uow.ground_truth.judged(window, filters, limit=MAX_POINTS + 1)
        cut = len(found) > MAX_POINTS
        kept = found[:MAX_POINTS]
        complete = datetime.fromtimestamp(kept[-1].t, tz=window.since.tzinfo) if cut else None
        return Table(window, accuracy_rows(window, kept, by), complete)

    def storage(self) -> tuple[StorageRow, ...]:
        """Bytes by what they hold, and what the disk has left."""
        with self._uow() as uow:
            rows = tuple(uow.inventory.storage())
        if self._host is None:
            return rows
        disk = self._host.disk()
        measured = {
            "database_file": disk.database,
            "map_cache": disk.map_cache,
            "disk_free": disk.free,
            "disk_total": disk.total,
        }
        return (*rows, *(StorageRow(part, None, size, estimated=False) for part, size in measured.items()))

    def levels(
        self,
        window: Window,
        *,
        venue_id: str | None = None,
        level_id: str | None = None,
        cursor: str | None = None,
        limit: int = DEFAULT_LIMIT,
    ) -> Page[LevelRow]:
        """Levels, newest first: traffic in the window, last walk, map and its age."""
        limit = check_limit(limit)
        now = self._clock()
        with self._uow() as uow:
            found = uow.inventory.levels(window, venue_id=venue_id, level_id=level_id, cursor=cursor, limit=limit + 1)
        rows = tuple(_aged(row, now) for row in found[:limit])
        return Page(rows, rows[-1].level_id if len(found) > limit else None)


def _aged(row: LevelRow, now: datetime) -> LevelRow:
    if row.map_created_at is None:
        return row
    return replace(row, map_age_days=round((now - row.map_created_at) / timedelta(days=1), 3))


def _latest(times: Iterable[datetime | None]) -> datetime | None:
    known = [time for time in times if time is not None]
    return max(known, default=None)
