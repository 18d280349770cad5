"""From what was read to the rows of the answers: counts, percentiles and shares, bucket by bucket."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from datetime import UTC, datetime, timedelta
from typing import TypeVar

import numpy as np

from app.engine.types import Status
from app.services.ground_truth_records import Judged
from app.services.records import JobKind, JobState
from app.services.stats_records import (
    AccuracyRow,
    BacklogRow,
    ErrorRow,
    Failure,
    FixCount,
    FixRow,
    GroupBy,
    JobTimes,
    LatencyRow,
    SegmentCount,
    ThroughputRow,
    Waiting,
    Window,
)

T = TypeVar("T")
K = TypeVar("K", bound=Hashable)

_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_PERCENTILES = (50, 90, 95, 99)
_Z95 = 1.959964
_VARIABLE = re.compile(r"\b[a-z]{2,4}_[0-9a-f]{20,}\b|'[^']*'|\"[^\"]*\"|[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")
_TEXT_LENGTH = 200


def bucket_starts(window: Window) -> list[datetime]:
    """Starts of the window's buckets, oldest first; a window without buckets is one."""
    if window.bucket is None:
        return [window.since]
    length = window.bucket.length
    start = _floor(window.since, length)
    n = max(1, -(-(window.until - start) // length))
    return [start + i * length for i in range(n)]


def bucket_of(window: Window, at: datetime) -> datetime:
    """Start of the bucket in which a time lies."""
    return window.since if window.bucket is None else _floor(at, window.bucket.length)


def throughput_rows(window: Window, found: Iterable[SegmentCount]) -> tuple[ThroughputRow, ...]:
    """One row a bucket, empty ones too: a gap is what one looks for."""
    by_start = _grouped(found, lambda one: bucket_of(window, one.at))
    return tuple(_throughput(window, start, by_start.get(start, ())) for start in bucket_starts(window))


def latency_rows(window: Window, found: Iterable[JobTimes]) -> tuple[LatencyRow, ...]:
    """One row for each bucket and kind with jobs that ended, oldest first."""
    groups = _grouped(found, lambda one: (bucket_of(window, one.created_at), one.kind))
    return tuple(_latency(start, kind, groups[start, kind]) for start, kind in sorted(groups))


def backlog_rows(found: Iterable[Waiting], now: datetime) -> tuple[BacklogRow, ...]:
    """One row a kind, of kinds without work too."""
    by_key = {(one.kind, one.state): one for one in found}

    def row(kind: JobKind) -> BacklogRow:
        queued, running = by_key.get((kind, JobState.QUEUED)), by_key.get((kind, JobState.RUNNING))
        return BacklogRow(
            kind=kind,
            queued=queued.n if queued else 0,
            running=running.n if running else 0,
            oldest_queued_s=None if queued is None else _age_s(queued.oldest_at, now),
            oldest_running_s=None if running is None else _age_s(running.oldest_at, now),
        )

    return tuple(row(kind) for kind in JobKind)


def error_rows(failures: Sequence[Failure], n_ended: Mapping[JobKind, int]) -> tuple[ErrorRow, ...]:
    """One row for each kind and sort of text, the most frequent first; the newest failure is the example."""
    groups = _grouped(failures, lambda one: (one.kind, text_class(one.error)))
    rows = [_error(kind, text, of, n_ended.get(kind, 0)) for (kind, text), of in groups.items()]
    return tuple(sorted(rows, key=lambda row: (-row.n, row.kind, row.text)))


def text_class(error: str) -> str:
    """What an error says without what differs from case to case: ids, numbers and quoted values become ``…``."""
    return _VARIABLE.sub("…", error.partition("\n")[0])[:_TEXT_LENGTH]


def fix_rows(window: Window, found: Iterable[FixCount], by: Sequence[GroupBy]) -> tuple[FixRow, ...]:
    """One row for each bucket and group with fixes, oldest first."""
    groups = _grouped(found, lambda one: (bucket_of(window, one.at), *_group(one, by)))
    return tuple(_fixes(key, groups[key]) for key in sorted(groups, key=_sortable))


def accuracy_rows(window: Window, found: Iterable[Judged], by: Sequence[GroupBy]) -> tuple[AccuracyRow, ...]:
    """Two rows for each bucket and group with known positions: of all fixes, and of the sure ones if any are."""
    groups = _grouped(found, lambda one: (bucket_of(window, _time(one.t)), *_group(one, by)))
    rows = []
    for key in sorted(groups, key=_sortable):
        sure = [one for one in groups[key] if one.sure]
        rows.append(_accuracy(key, "all", groups[key]))
        if sure:
            rows.append(_accuracy(key, "sure", sure))
    return tuple(rows)


def wilson(n_hit: int, n: int) -> tuple[float, float]:
    """95 % interval of a share of which ``n_hit`` of ``n`` were seen (Wilson, 1927, eq. 7 without continuity).

    Unlike the normal approximation it stays within 0 and 1 and means something for small ``n`` and shares near 1.
    """
    share, z2 = n_hit / n, _Z95**2
    centre = (share + z2 / (2 * n)) / (1 + z2 / n)
    half = _Z95 / (1 + z2 / n) * ((share * (1 - share) + z2 / (4 * n)) / n) ** 0.5
    return max(0.0, centre - half), min(1.0, centre + half)


def _floor(at: datetime, length: timedelta) -> datetime:
    return at - (at - _EPOCH) % length


def _time(t: float) -> datetime:
    return datetime.fromtimestamp(t, UTC)


def _age_s(since: datetime, now: datetime) -> float:
    return max(0.0, (now - since).total_seconds())


def _grouped(items: Iterable[T], key: Callable[[T], K]) -> dict[K, list[T]]:
    groups: dict[K, list[T]] = defaultdict(list)
    for item in items:
        groups[key(item)].append(item)
    return groups


def _group(one: FixCount | Judged, by: Sequence[GroupBy]) -> tuple[str | None, str | None, str | None]:
    return (
        one.level_id if GroupBy.LEVEL in by else None,
        one.device_id if GroupBy.DEVICE in by else None,
        one.method if GroupBy.METHOD in by else None,
    )


_Key = tuple[datetime, str | None, str | None, str | None]


def _sortable(key: _Key) -> tuple[datetime, str, str, str]:
    start, *names = key
    level, device, method = (name or "" for name in names)
    return start, level, device, method


def _throughput(window: Window, start: datetime, found: Sequence[SegmentCount]) -> ThroughputRow:
    end = window.until if window.bucket is None else min(start + window.bucket.length, window.until)
    seconds = max((end - max(start, window.since)).total_seconds(), 1e-3)
    n, n_fixes = sum(one.n for one in found), sum(one.n_fixes for one in found)
    return ThroughputRow(
        since=start,
        segments=n,
        samples=sum(one.n_samples for one in found),
        fixes=n_fixes,
        segments_failed=sum(one.n for one in found if one.state is JobState.FAILED),
        segments_per_s=round(n / seconds, 4),
        fixes_per_s=round(n_fixes / seconds, 4),
    )


def _latency(start: datetime, kind: JobKind, found: Sequence[JobTimes]) -> LatencyRow:
    times = np.array(
        [(one.created_at.timestamp(), one.started_at.timestamp(), one.finished_at.timestamp()) for one in found]
    )
    created, started, finished = times.T
    spans = {"wait": started - created, "processing": finished - started, "total": finished - created}
    figures = {
        f"{name}_p{percent}_ms": round(float(value) * 1000, 3)
        for name, span in spans.items()
        # a clock that was set back between the two ends
        for percent, value in zip(_PERCENTILES, np.percentile(np.maximum(span, 0.0), _PERCENTILES), strict=True)
    }
    return LatencyRow(since=start, kind=kind, n=len(found), **figures)


def _error(kind: JobKind, text: str, found: Sequence[Failure], n_ended: int) -> ErrorRow:
    newest = max(found, key=lambda one: one.at)
    return ErrorRow(
        kind=kind,
        text=text,
        n=len(found),
        share=len(found) / max(n_ended, len(found)),
        first_at=min(one.at for one in found),
        last_at=newest.at,
        example_job_id=newest.job_id,
        example_subject_id=newest.subject_id,
        example_seq=newest.seq,
        example_error=newest.error,
    )


def _fixes(key: _Key, found: Sequence[FixCount]) -> FixRow:
    start, level_id, device_id, method = key
    n = sum(one.n for one in found)

    def count(status: Status) -> int:
        return sum(one.n for one in found if one.status == status)

    return FixRow(
        since=start,
        level_id=level_id,
        device_id=device_id,
        method=method,
        n=n,
        ok=count(Status.OK),
        ambiguous=count(Status.AMBIGUOUS),
        insufficient=count(Status.INSUFFICIENT),
        off_map=count(Status.OFF_MAP),
        disturbed=count(Status.DISTURBED),
        sure_share=sum(one.n for one in found if one.sure) / n,
    )


def _accuracy(key: _Key, fixes: str, found: Sequence[Judged]) -> AccuracyRow:
    start, level_id, device_id, method = key
    p50, p90, p95 = np.percentile([one.error_m for one in found], (50, 90, 95))
    n_inside = sum(one.inside for one in found)
    low, high = wilson(n_inside, len(found))
    return AccuracyRow(
        since=start,
        fixes=fixes,
        level_id=level_id,
        device_id=device_id,
        method=method,
        n=len(found),
        p50_m=float(p50),
        p90_m=float(p90),
        p95_m=float(p95),
        inside_share=n_inside / len(found),
        inside_low=low,
        inside_high=high,
    )
