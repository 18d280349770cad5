"""What operators ask, and the rows of the answers. Times are UTC datetimes, durations milliseconds where it says so.

Every row type is flat: it is a JSON object and a line of CSV alike.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from enum import StrEnum
from typing import Generic, TypeVar

from app.services.records import JobKind, JobState

R = TypeVar("R")


class Bucket(StrEnum):
    """Length of a stretch of time that is counted for itself; days are UTC days."""

    MINUTE = "minute"
    HOUR = "hour"
    DAY = "day"

    @property
    def length(self) -> timedelta:
        """How long one is."""
        return _LENGTHS[self]


_LENGTHS = {Bucket.MINUTE: timedelta(minutes=1), Bucket.HOUR: timedelta(hours=1), Bucket.DAY: timedelta(days=1)}


class GroupBy(StrEnum):
    """What fixes and errors are told apart by."""

    LEVEL = "level"
    DEVICE = "device"
    METHOD = "method"


@dataclass(frozen=True, slots=True)
class Window:
    """From ``since`` (in) to ``until`` (out); counted bucket by bucket, or as a whole.

    ``open_end``: nothing is newer than ``until``, so that ids need no bound (they may be ahead of a clock that was set
    back).
    """

    since: datetime
    until: datetime
    bucket: Bucket | None = None
    open_end: bool = False


@dataclass(frozen=True, slots=True)
class Filters:
    """Only what belongs to these; None: whatever it belongs to."""

    venue_id: str | None = None
    level_id: str | None = None
    device_id: str | None = None
    method: str | None = None


NO_FILTERS = Filters()


@dataclass(frozen=True, slots=True)
class Table(Generic[R]):
    """Rows of an answer about a window.

    ``complete_since``: when more was stored than one question may read, the newest was, and what lies before this time
    is missing; None if nothing is.
    """

    window: Window
    rows: tuple[R, ...]
    complete_since: datetime | None = None


@dataclass(frozen=True, slots=True)
class Read(Generic[R]):
    """What a bounded question read; ``complete_since`` as in :class:`Table`."""

    rows: Sequence[R]
    complete_since: datetime | None


@dataclass(frozen=True, slots=True)
class SegmentCount:
    """Accepted segments of one bucket and state: how many, their samples, and the fixes they gave so far."""

    at: datetime
    state: JobState
    n: int
    n_samples: int
    n_fixes: int


@dataclass(frozen=True, slots=True)
class JobTimes:
    """When a job that ended was accepted, begun (in the attempt that counts) and ended."""

    kind: JobKind
    created_at: datetime
    started_at: datetime
    finished_at: datetime


@dataclass(frozen=True, slots=True)
class Failure:
    """A job that failed; ``subject_id`` is its session or level, ``seq`` its segment."""

    job_id: str
    kind: JobKind
    subject_id: str
    seq: int | None
    error: str
    at: datetime


@dataclass(frozen=True, slots=True)
class FixCount:
    """Fixes of one bucket that are alike."""

    at: datetime
    level_id: str
    device_id: str | None
    method: str
    status: str
    sure: bool
    n: int


@dataclass(frozen=True, slots=True)
class Waiting:
    """Jobs of one kind that are queued or running, and since when the oldest is."""

    kind: JobKind
    state: JobState
    n: int
    oldest_at: datetime


@dataclass(frozen=True, slots=True)
class Ended:
    """Jobs of one kind that ended, by outcome."""

    kind: JobKind
    n_done: int
    n_failed: int
    n_cancelled: int


@dataclass(frozen=True, slots=True)
class LastHeard:
    """An open session, and when it sent its last segment (or was opened)."""

    session_id: str
    device_id: str | None
    last_at: datetime


@dataclass(frozen=True, slots=True)
class ThroughputRow:
    """What was accepted in a stretch of time, and the fixes that came of it."""

    since: datetime
    segments: int
    samples: int
    fixes: int
    segments_failed: int
    segments_per_s: float
    fixes_per_s: float


@dataclass(frozen=True, slots=True)
class LatencyRow:
    """Percentiles over the jobs of a kind that were accepted in a stretch of time, ms."""

    since: datetime
    kind: JobKind
    n: int
    wait_p50_ms: float
    wait_p90_ms: float
    wait_p95_ms: float
    wait_p99_ms: float
    processing_p50_ms: float
    processing_p90_ms: float
    processing_p95_ms: float
    processing_p99_ms: float
    total_p50_ms: float
    total_p90_ms: float
    total_p95_ms: float
    total_p99_ms: float


@dataclass(frozen=True, slots=True)
class BacklogRow:
    """What waits and what runs of a kind; ages of the oldest, None where there is none."""

    kind: JobKind
    queued: int
    running: int
    oldest_queued_s: float | None
    oldest_running_s: float | None


@dataclass(frozen=True, slots=True)
class ErrorRow:
    """Failures of a kind whose texts are alike; the newest as an example. ``share`` is of all jobs that ended."""

    kind: JobKind
    text: str
    n: int
    share: float
    first_at: datetime
    last_at: datetime
    example_job_id: str
    example_subject_id: str
    example_seq: int | None
    example_error: str


@dataclass(frozen=True, slots=True)
class FixRow:
    """Fixes of a stretch of time by what they claim; None where they are not told apart."""

    since: datetime
    level_id: str | None
    device_id: str | None
    method: str | None
    n: int
    ok: int
    ambiguous: int
    insufficient: int
    off_map: int
    disturbed: int
    sure_share: float


@dataclass(frozen=True, slots=True)
class AccuracyRow:
    """Errors at known positions; ``inside_low`` and ``inside_high`` bound the share inside at 95 % (Wilson)."""

    since: datetime
    fixes: str
    level_id: str | None
    device_id: str | None
    method: str | None
    n: int
    p50_m: float
    p90_m: float
    p95_m: float
    inside_share: float
    inside_low: float
    inside_high: float


@dataclass(frozen=True, slots=True)
class StorageRow:
    """Bytes of a part of what is stored; ``estimated`` from row counts and the newest rows' sizes."""

    part: str
    rows: int | None
    bytes: int
    estimated: bool


@dataclass(frozen=True, slots=True)
class LevelRow:
    """A level: its traffic in the window, its last survey walk, its map."""

    level_id: str
    venue_id: str
    name: str
    sessions: int
    last_session_at: datetime | None
    walks: int
    last_walk_at: datetime | None
    map_id: str | None
    map_version: int | None
    map_created_at: datetime | None
    map_age_days: float | None
    map_behind: bool


@dataclass(frozen=True, slots=True)
class DiskUsage:
    """Of the data folder, bytes."""

    database: int
    map_cache: int
    free: int
    total: int
