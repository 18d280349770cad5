"""Answers to operators: flat rows, which are JSON objects and lines of CSV alike."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from datetime import datetime
from typing import Annotated, Any, Self

from pydantic import Field

from app.api.schemas.base import Out, PageOut, Time, example
from app.services.alarm_rules import Alarm, Severity
from app.services.records import JobKind
from app.services.stats_records import Bucket, Table

_SINCE = "2026-11-22T09:00:00.000Z"
_Share = Annotated[float, Field(ge=0, le=1)]
_Since = Annotated[Time, Field(description="Start of the bucket (or of all); UTC.")]


class RowOut(Out):
    """One row."""

    @classmethod
    def of(cls, row: Any) -> Self:
        """Show a row of the services."""
        return cls(**asdict(row))


class TableOut(Out):
    """Rows about a stretch of time."""

    since: Time
    until: Time
    bucket: Bucket | None
    complete_since: Annotated[
        Time | None,
        Field(description="More was stored than one call reads: what lies before this time is missing. Null: all is."),
    ]

    @classmethod
    def of(cls, table: Table[Any]) -> Self:
        """Show a table of the services."""
        window = table.window
        row_type: type[RowOut] = cls.model_fields["items"].annotation.__args__[0]  # type: ignore[union-attr]
        return cls(
            since=window.since,
            until=window.until,
            bucket=window.bucket,
            complete_since=table.complete_since,
            items=[row_type.of(row) for row in table.rows],
        )


def _table(bucket: str | None, *rows: dict[str, Any]) -> Any:
    head = {"since": _SINCE, "until": "2026-11-22T10:00:00.000Z", "bucket": bucket, "complete_since": None}
    return example({**head, "items": list(rows)})


class ThroughputRowOut(RowOut):
    """Segments accepted in a bucket, and the fixes that came of them so far."""

    since: _Since
    segments: int
    samples: int
    fixes: int
    segments_failed: int
    segments_per_s: float
    fixes_per_s: float


class ThroughputOut(TableOut):
    """How much came in."""

    model_config = _table(
        "hour",
        {
            "since": _SINCE,
            "segments": 7200,
            "samples": 1800000,
            "fixes": 64000,
            "segments_failed": 1,
            "segments_per_s": 2.0,
            "fixes_per_s": 17.78,
        },
    )

    items: list[ThroughputRowOut]


class LatencyRowOut(RowOut):
    """Percentiles over jobs of a kind, ms: waiting in the queue, being processed, and from acceptance to result."""

    since: _Since
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


_MS = {
    f"{name}_p{percent}_ms": value
    for name, values in {"wait": (2, 6, 9, 30), "processing": (38, 61, 75, 140), "total": (41, 68, 83, 160)}.items()
    for percent, value in zip((50, 90, 95, 99), values, strict=True)
}


class LatencyOut(TableOut):
    """How long it took."""

    model_config = _table(None, {"since": _SINCE, "kind": "locate_segment", "n": 7199, **_MS})

    items: list[LatencyRowOut]


class BacklogRowOut(RowOut):
    """Jobs of a kind that wait and that run; ages of the oldest, s."""

    kind: JobKind
    queued: int
    running: int
    oldest_queued_s: float | None
    oldest_running_s: float | None


class BacklogOut(Out):
    """What is to be done."""

    model_config = example(
        {
            "items": [
                {
                    "kind": "locate_segment",
                    "queued": 3,
                    "running": 2,
                    "oldest_queued_s": 0.12,
                    "oldest_running_s": 0.05,
                }
            ]
        }
    )

    items: list[BacklogRowOut]


class ErrorRowOut(RowOut):
    """Failures of a kind that say the same; `…` stands for what differs. The newest is the example."""

    kind: JobKind
    text: str
    n: int
    share: Annotated[float, Field(ge=0, le=1, description="Of all jobs of the kind that ended.")]
    first_at: Time
    last_at: Time
    example_job_id: str
    example_subject_id: Annotated[str, Field(description="Its session, or its level.")]
    example_seq: Annotated[int | None, Field(description="Its segment.")]
    example_error: str


class ErrorsOut(TableOut):
    """What failed."""

    model_config = _table(
        None,
        {
            "kind": "locate_segment",
            "text": "the worker died in each of … attempts",
            "n": 1,
            "share": 0.0001,
            "first_at": _SINCE,
            "last_at": _SINCE,
            "example_job_id": "job_019ab2c4d1e07f3a9b2c4d5e6f",
            "example_subject_id": "ses_019ab2c4d1e07f3a9b2c4d5e6f",
            "example_seq": 12,
            "example_error": "the worker died in each of 3 attempts",
        },
    )

    items: list[ErrorRowOut]


class FixRowOut(RowOut):
    """Fixes by what they claim; level, device and method where `by` tells them apart."""

    since: _Since
    level_id: str | None
    device_id: str | None
    method: str | None
    n: int
    ok: int
    ambiguous: int
    insufficient: int
    off_map: int
    disturbed: int
    sure_share: _Share


class FixCountsOut(TableOut):
    """What fixes claimed."""

    model_config = _table(
        None,
        {
            "since": _SINCE,
            "level_id": "lvl_019ab2c4d1e07f3a9b2c4d5e6f",
            "device_id": None,
            "method": None,
            "n": 64000,
            "ok": 60000,
            "ambiguous": 1500,
            "insufficient": 2000,
            "off_map": 400,
            "disturbed": 100,
            "sure_share": 0.91,
        },
    )

    items: list[FixRowOut]


class AccuracyRowOut(RowOut):
    """Errors at known positions, m, and how often the 95 % ellipse held them."""

    since: _Since
    fixes: Annotated[str, Field(description="`all`, or only the `sure` ones.")]
    level_id: str | None
    device_id: str | None
    method: str | None
    n: int
    p50_m: float
    p90_m: float
    p95_m: float
    inside_share: _Share
    inside_low: Annotated[float, Field(ge=0, le=1, description="95 % interval of the share (Wilson), from")]
    inside_high: Annotated[float, Field(ge=0, le=1, description="... to.")]


class AccuracyOut(TableOut):
    """The error budget: how well claims hold where the truth is known."""

    model_config = _table(
        None,
        {
            "since": _SINCE,
            "fixes": "sure",
            "level_id": None,
            "device_id": None,
            "method": None,
            "n": 120,
            "p50_m": 1.4,
            "p90_m": 3.1,
            "p95_m": 4.0,
            "inside_share": 0.95,
            "inside_low": 0.895,
            "inside_high": 0.977,
        },
    )

    items: list[AccuracyRowOut]


class StorageRowOut(RowOut):
    """Bytes of a part; the parts that are measured are files and the disk."""

    part: str
    rows: int | None
    bytes: int
    estimated: Annotated[bool, Field(description="From the number of rows and the size of some.")]


class StorageOut(Out):
    """What takes the space."""

    model_config = example(
        {
            "items": [
                {"part": "segments", "rows": 7200, "bytes": 41000000, "estimated": True},
                {"part": "disk_free", "rows": None, "bytes": 52000000000, "estimated": False},
            ]
        }
    )

    items: list[StorageRowOut]


class LevelRowOut(RowOut):
    """A level: sessions that were opened on it in the window, its walks, its map."""

    level_id: str
    venue_id: str
    name: str
    sessions: int
    last_session_at: Time | None
    walks: int
    last_walk_at: Time | None
    map_id: str | None
    map_version: int | None
    map_created_at: Time | None
    map_age_days: float | None
    map_behind: Annotated[bool, Field(description="A walk was uploaded after the map was made.")]


class LevelStatsPage(PageOut):
    """Levels, newest first."""

    model_config = example(
        {
            "items": [
                {
                    "level_id": "lvl_019ab2c4d1e07f3a9b2c4d5e6f",
                    "venue_id": "ven_019ab2c4d1e07f3a9b2c4d5e6f",
                    "name": "F2",
                    "sessions": 120,
                    "last_session_at": _SINCE,
                    "walks": 84,
                    "last_walk_at": _SINCE,
                    "map_id": "map_019ab2c4d1e07f3a9b2c4d5e6f",
                    "map_version": 3,
                    "map_created_at": _SINCE,
                    "map_age_days": 0.5,
                    "map_behind": False,
                }
            ],
            "next_cursor": None,
        }
    )

    items: list[LevelRowOut]


class AlarmOut(RowOut):
    """A rule that found something."""

    rule: Annotated[str, Field(description="docs/operations.md lists all.")]
    severity: Severity
    subject: Annotated[str, Field(description="Id of a level, device or session, a kind of jobs, or what else.")]
    message: str
    since: Annotated[Time | None, Field(description="Null: nobody knows.")]
    remedy: str


class AlarmsOut(Out):
    """What is worth attention now, the most severe first."""

    model_config = example(
        {
            "items": [
                {
                    "rule": "queue-old",
                    "severity": "warning",
                    "subject": "locate_segment",
                    "message": "210 wait, the oldest for 42 s",
                    "since": _SINCE,
                    "remedy": "more comes in than the workers can do: raise ISODYN_WORKERS, or send less",
                }
            ]
        }
    )

    items: list[AlarmOut]

    @classmethod
    def of(cls, alarms: Sequence[Alarm]) -> Self:
        """Show alarms."""
        return cls(items=[AlarmOut.of(alarm) for alarm in alarms])


def cell(value: object) -> object:
    """A value as CSV has it: times as in JSON, true and false in lower case, nothing for null."""
    if isinstance(value, datetime):
        return value.isoformat(timespec="milliseconds").replace("+00:00", "Z")
    if isinstance(value, bool):
        return str(value).lower()
    return value
