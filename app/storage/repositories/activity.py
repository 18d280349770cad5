"""What the service did when.

Ids begin with the time at which a thing was made, so a stretch of time is a range of an index that is there already:
``(kind, id)`` of jobs. Every question first finds the job from which on it may read (``limit`` newest of its window),
and looks at nothing before that, whatever the filters leave over.
"""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from typing import Any

from sqlalchemy import (
    BigInteger,
    ColumnElement,
    Integer,
    Label,
    Row,
    and_,
    cast,
    exists,
    extract,
    func,
    literal_column,
    select,
)

from app.services.records import JobKind, JobState
from app.services.stats_records import (
    NO_FILTERS,
    Ended,
    Failure,
    Filters,
    FixCount,
    JobTimes,
    Read,
    SegmentCount,
    Waiting,
    Window,
)
from app.storage.models import fixes, jobs, levels, segments, sessions
from app.storage.repositories.base import Repository

_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_SECOND = timedelta(seconds=1)
_MILLISECOND = timedelta(milliseconds=1)
_BUCKET: ColumnElement[int] = literal_column("bucket", Integer)
_ENDED = (JobState.DONE.value, JobState.FAILED.value)


def first_id(prefix: str, at: datetime) -> str:
    """Smallest id that a thing made at this time could have; times before 1970 are its start."""
    return f"{prefix}_{max(0, int(at.timestamp() * 1000)):012x}"


def time_of(id_: str) -> datetime:
    """When the thing of this id was made, to the millisecond."""
    return datetime.fromtimestamp(int(id_.partition("_")[2][:12], 16) / 1000, UTC)


def session_conditions(filters: Filters) -> list[ColumnElement[bool]]:
    """Conditions on a row of ``sessions``."""
    wanted = {name: getattr(filters, name) for name in ("venue_id", "level_id", "device_id", "method")}
    return [sessions.c[name] == value for name, value in wanted.items() if value is not None]


class SqlActivityRepository(Repository):
    """Port ``ActivityRepository``."""

    def segments(self, window: Window, filters: Filters, *, limit: int) -> Read[SegmentCount]:
        """Accepted segments of the window."""
        low, complete = self._from(JobKind.LOCATE_SEGMENT, window, limit)
        statement = (
            select(
                _bucket(window),
                jobs.c.state,
                func.count().label("n"),
                func.sum(segments.c.n_samples).label("n_samples"),
                func.coalesce(func.sum(segments.c.n_fixes), 0).label("n_fixes"),
            )
            .join(segments, _segment_of_job())
            .where(*_in(JobKind.LOCATE_SEGMENT, low, window), *_of(JobKind.LOCATE_SEGMENT, filters))
            .group_by(_BUCKET, jobs.c.state)
        )
        rows = tuple(
            SegmentCount(_start(window, row.bucket), JobState(row.state), row.n, row.n_samples, row.n_fixes)
            for row in self._read(statement)
        )
        return Read(rows, complete)

    def job_times(self, kind: JobKind, window: Window, filters: Filters, *, limit: int) -> Read[JobTimes]:
        """Jobs that are done or failed; those that were cancelled say nothing of the service."""
        low, complete = self._from(kind, window, limit)
        statement = select(jobs.c.created_at, jobs.c.started_at, jobs.c.finished_at).where(
            *_in(kind, low, window), *_of(kind, filters), _state(*_ENDED), jobs.c.started_at.is_not(None)
        )
        rows = tuple(JobTimes(kind, row.created_at, row.started_at, row.finished_at) for row in self._read(statement))
        return Read(rows, complete)

    def failures(self, kind: JobKind, window: Window, filters: Filters, *, limit: int) -> Read[Failure]:
        """Jobs that failed, newest first."""
        low, complete = self._from(kind, window, limit)
        statement = (
            select(jobs.c.id, jobs.c.subject, jobs.c.error, jobs.c.created_at, jobs.c.finished_at)
            .where(*_in(kind, low, window), *_of(kind, filters), _state(JobState.FAILED.value))
            .order_by(jobs.c.id.desc())
        )
        return Read(tuple(_failure(kind, row) for row in self._read(statement)), complete)

    def ended(self, kind: JobKind, window: Window, filters: Filters, *, limit: int) -> Ended:
        """How many jobs ended how."""
        low, _ = self._from(kind, window, limit)
        statement = select(jobs.c.state, func.count().label("n")).where(*_in(kind, low, window), *_of(kind, filters))
        found = {row.state: row.n for row in self._read(statement.group_by(jobs.c.state))}
        done, failed, cancelled = (
            found.get(state.value, 0) for state in (JobState.DONE, JobState.FAILED, JobState.CANCELLED)
        )
        return Ended(kind, done, failed, cancelled)

    def fixes(self, window: Window, filters: Filters, *, limit: int) -> Read[FixCount]:
        """Fixes of the segments that were accepted in the window, alike ones of a segment together."""
        low, complete = self._from(JobKind.LOCATE_SEGMENT, window, limit)
        on_session = Filters(filters.venue_id, None, filters.device_id, filters.method)
        columns = (
            fixes.c.level_id,
            sessions.c.device_id,
            sessions.c.method,
            fixes.c.status,
            fixes.c.sure,
        )
        told = and_(
            fixes.c.session_id == segments.c.session_id,
            fixes.c.number >= segments.c.first_fix,
            fixes.c.number < segments.c.first_fix + segments.c.n_fixes,
        )
        statement = (
            select(_bucket(window), *columns, func.count().label("n"))
            .join(segments, _segment_of_job())
            .join(sessions, sessions.c.id == segments.c.session_id)
            .join(fixes, told)
            .where(*_in(JobKind.LOCATE_SEGMENT, low, window), *session_conditions(on_session))
            .group_by(_BUCKET, *columns)
        )
        if filters.level_id is not None:
            statement = statement.where(fixes.c.level_id == filters.level_id)
        rows = tuple(
            FixCount(_start(window, row.bucket), row.level_id, row.device_id, row.method, row.status, row.sure, row.n)
            for row in self._read(statement)
        )
        return Read(rows, complete)

    def waiting(self) -> Sequence[Waiting]:
        """What is queued and running, by kind."""
        oldest = (
            select(jobs.c.state, jobs.c.kind, func.count().label("n"), func.min(jobs.c.number).label("number"))
            .where(jobs.c.state.in_([JobState.QUEUED.value, JobState.RUNNING.value]))
            .group_by(jobs.c.state, jobs.c.kind)
            .subquery()
        )
        # what runs is as old as its attempt, what waits as old as its acceptance
        statement = select(oldest, jobs.c.created_at, jobs.c.started_at).join(jobs, jobs.c.number == oldest.c.number)
        return tuple(
            Waiting(JobKind(row.kind), JobState(row.state), row.n, row.started_at or row.created_at)
            for row in self._read(statement)
        )

    def _from(self, kind: JobKind, window: Window, limit: int) -> tuple[str, datetime | None]:
        """Smallest id that may be read, and when it is not the window's own the time from which on all is read."""
        low = first_id("job", window.since)
        beyond = select(jobs.c.id).where(*_range(kind, low, window)).order_by(jobs.c.id.desc()).offset(limit).limit(1)
        found = self._read(beyond).scalar()
        if found is None:
            return low, None
        complete = time_of(found) + _MILLISECOND
        return first_id("job", complete), complete


def _bucket(window: Window) -> Label[int]:
    """Which bucket since 1970 a job was accepted in; milliseconds in between, as some databases round to integers."""
    if window.bucket is None:
        return literal_column("0", Integer).label("bucket")
    milliseconds = cast(extract("epoch", jobs.c.created_at) * 1000, BigInteger)
    return (milliseconds // (1000 * (window.bucket.length // _SECOND))).label("bucket")


def _start(window: Window, bucket: int) -> datetime:
    return window.since if window.bucket is None else _EPOCH + bucket * window.bucket.length


def _segment_of_job() -> ColumnElement[bool]:
    return and_(segments.c.session_id == jobs.c.order_key, segments.c.seq == jobs.c.subject["seq"].as_integer())


def _in(kind: JobKind, low: str, window: Window) -> tuple[ColumnElement[bool], ...]:
    return (
        *_range(kind, low, window),
        # exactly: an id may be ahead of the clock, after this was set back
        jobs.c.created_at >= window.since,
        jobs.c.created_at < window.until,
    )


def _range(kind: JobKind, low: str, window: Window) -> tuple[ColumnElement[bool], ...]:
    begun = (jobs.c.kind == kind.value, jobs.c.id >= low)
    return begun if window.open_end else (*begun, jobs.c.id < first_id("job", window.until))


def _state(*states: str) -> ColumnElement[bool]:
    """States, in a way that no index can answer: the range of ids is what bounds the work."""
    return func.coalesce(jobs.c.state, "").in_(states)


def _of(kind: JobKind, filters: Filters) -> tuple[ColumnElement[bool], ...]:
    """Conditions on a job: those of its session, or of its level; a map build is of no device or method."""
    if filters == NO_FILTERS:
        return ()
    if kind is JobKind.BUILD_MAP:
        if filters.device_id is not None or filters.method is not None:
            return (jobs.c.id.is_(None),)
        wanted = [levels.c.id == jobs.c.order_key]
        if filters.venue_id is not None:
            wanted.append(levels.c.venue_id == filters.venue_id)
        if filters.level_id is not None:
            wanted.append(levels.c.id == filters.level_id)
        return (exists().where(*wanted).correlate(jobs),)
    session_id = jobs.c.order_key if kind is JobKind.LOCATE_SEGMENT else jobs.c.subject["session_id"].as_string()
    return (exists().where(sessions.c.id == session_id, *session_conditions(filters)).correlate(jobs),)


def _failure(kind: JobKind, row: Row[Any]) -> Failure:
    subject = row.subject
    return Failure(
        job_id=row.id,
        kind=kind,
        subject_id=str(subject.get("session_id") or subject.get("level_id") or ""),
        seq=subject.get("seq"),
        error=row.error or "",
        at=row.finished_at or row.created_at,
    )
