"""Sessions, their segments, tracker states and fixes.

The statements that each segment needs are built once: composing them costs more than SQLite takes to run them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, astuple
from datetime import datetime
from functools import partial
from typing import Any

from sqlalchemy import BindParameter, Row, ScalarSelect, Table, bindparam, func, insert, select, update

from app.engine.localization.codec import calibration_from, prior_from
from app.engine.types import DeviceCalibration, Fix, FixKind, Hypothesis, Status, TrackerState
from app.services.aids import Recording
from app.services.errors import SequenceGapError
from app.services.records import (
    JobState,
    LastKnown,
    LevelMap,
    NewSegment,
    Page,
    Position,
    SegmentInfo,
    SegmentResult,
    Session,
    SessionStatus,
)
from app.storage.columns import AID_COLUMNS, decode_aids, decode_samples, encode_aids, encode_samples
from app.storage.models import fixes, jobs, lagged_fixes, segment_samples, segments, sessions, tracker_states
from app.storage.repositories.base import Repository, expect_one, page

_ID: BindParameter[Any] = bindparam("session")
_SEQ: BindParameter[Any] = bindparam("number")
_NOW: BindParameter[Any] = bindparam("now")
_SEGMENT_KEY = (segments.c.session_id == _ID, segments.c.seq == _SEQ)

_GET = select(sessions).where(sessions.c.id == _ID)
_GET_LOCKED = _GET.with_for_update()  # two writers of one session take turns; SQLite's take turns anyway
_INSERT = insert(sessions)
_ADVANCE = (
    update(sessions)
    .where(sessions.c.id == _ID, sessions.c.next_seq == _SEQ, sessions.c.status == SessionStatus.OPEN.value)
    .values(next_seq=sessions.c.next_seq + 1)
)
_SEGMENTS = select(segments, jobs.c.state.label("job_state")).join(jobs, jobs.c.id == segments.c.job_id)
_GET_SEGMENT = _SEGMENTS.where(*_SEGMENT_KEY)
_LAST_SEGMENT = _SEGMENTS.where(segments.c.session_id == _ID).order_by(segments.c.seq.desc()).limit(1)
_INSERT_SEGMENT = insert(segments)
_INSERT_SAMPLES = insert(segment_samples)
_SAMPLES = select(segment_samples.c.samples, *(segment_samples.c[name] for name in AID_COLUMNS))
_LOAD_SEGMENT = _SAMPLES.where(segment_samples.c.session_id == _ID, segment_samples.c.seq == _SEQ)
_LOAD_DONE_SEGMENTS = (
    _SAMPLES.join(
        segments, (segments.c.session_id == segment_samples.c.session_id) & (segments.c.seq == segment_samples.c.seq)
    )
    .join(jobs, jobs.c.id == segments.c.job_id)
    .where(segment_samples.c.session_id == _ID, jobs.c.state == JobState.DONE.value)
    .order_by(segment_samples.c.seq)
    .limit(bindparam("count"))
)
_GET_STATE = select(tracker_states).where(tracker_states.c.session_id == _ID)
_UPDATE_STATE = (
    update(tracker_states)
    .where(tracker_states.c.session_id == _ID)
    .values(method=bindparam("new_method"), payload=bindparam("new_payload"), last_t=bindparam("new_last_t"))
)
_UPDATE_STATE_AND_CALIBRATION = _UPDATE_STATE.values(calibration=bindparam("new_calibration"))
_INSERT_STATE = insert(tracker_states)
_GET_CALIBRATION = select(tracker_states.c.calibration).where(tracker_states.c.session_id == _ID)
_MARK_REMEMBERED = (
    update(sessions).where(sessions.c.id == _ID, sessions.c.remembered_at.is_(None)).values(remembered_at=_NOW)
)


def _last_number(table: Table) -> ScalarSelect[Any]:
    return select(func.max(table.c.number)).where(table.c.session_id == _ID).scalar_subquery()


# locked, so that of closing a session and finishing its last segment one comes second and sees both
_LAST_NUMBERS = (
    select(sessions.c.status, _last_number(fixes).label("number"), _last_number(lagged_fixes).label("lagged_number"))
    .where(sessions.c.id == _ID)
    .with_for_update(of=sessions)
)
_FIX_COLUMNS = [column.label(f"fix_{column.name}") for column in fixes.c]
_TOLD = fixes.alias("told")
_LAST_TOLD = (
    select(func.max(_TOLD.c.number)).where(_TOLD.c.session_id == sessions.c.id).correlate(sessions).scalar_subquery()
)
_LAST_KNOWN = select(sessions, *_FIX_COLUMNS).select_from(
    sessions.outerjoin(fixes, (fixes.c.session_id == sessions.c.id) & (fixes.c.number == _LAST_TOLD))
)
_INSERT_FIXES = insert(fixes)
_INSERT_LAGGED = insert(lagged_fixes)
_MARK_PROCESSED = (
    update(segments)
    .where(*_SEGMENT_KEY)
    .values(
        processed_at=_NOW,
        first_fix=bindparam("first"),
        n_fixes=bindparam("count"),
        first_lagged=bindparam("lagged_first"),
        n_lagged=bindparam("lagged_count"),
    )
)
_TABLES = {FixKind.FILTERED: fixes, FixKind.FIXED_LAG: lagged_fixes}
_FIXES_OF = {
    kind: select(table)
    .where(table.c.session_id == _ID, table.c.number >= bindparam("first"), table.c.number < bindparam("end"))
    .order_by(table.c.number)
    for kind, table in _TABLES.items()
}
_MARK_FAILED = update(segments).where(*_SEGMENT_KEY).values(processed_at=_NOW, error=bindparam("message"))


class SqlSessionRepository(Repository):
    """Port ``SessionRepository``."""

    def add(self, session: Session) -> None:
        """Store a session."""
        self._write(
            _INSERT,
            {
                "id": session.id,
                "venue_id": session.venue_id,
                "level_id": session.level_id,
                "maps": [[one.level_id, one.map_id] for one in session.maps],
                "device_id": session.device_id,
                "method": session.method,
                "parameters": dict(session.parameters),
                "prior": asdict(session.prior),
                "status": session.status,
                "next_seq": session.next_seq,
                "created_at": session.created_at,
                "closed_at": session.closed_at,
                "calibration_epoch": session.calibration_epoch,
                "method_reason": session.method_reason,
                "contributor": session.contributor,
            },
        )

    def get(self, session_id: str) -> Session:
        """One session; in a writing transaction no other one changes it until this ends."""
        statement = _GET_LOCKED if self._writable else _GET
        return _session(self._one("session", session_id, statement, {"session": session_id}))

    def list(
        self,
        *,
        venue_id: str | None,
        level_id: str | None,
        device_id: str | None,
        status: str | None,
        cursor: str | None,
        limit: int,
    ) -> Page[Session]:
        """Sessions, newest first."""
        statement = select(sessions)
        wanted = {"venue_id": venue_id, "level_id": level_id, "device_id": device_id, "status": status}
        for name, value in wanted.items():
            if value is not None:
                statement = statement.where(sessions.c[name] == value)
        return self._newest_first(statement, sessions.c.id, _session, cursor=cursor, limit=limit)

    def close(self, session_id: str, now: datetime) -> Session:
        """Take no more segments; a closed session stays as it is."""
        self._write(
            update(sessions)
            .where(sessions.c.id == session_id, sessions.c.status == SessionStatus.OPEN)
            .values(status=SessionStatus.CLOSED, closed_at=now)
        )
        return self.get(session_id)

    def add_segment(self, session_id: str, segment: NewSegment, job_id: str, now: datetime) -> None:
        """Store the raw samples as compressed columns and advance ``next_seq``."""
        key = {"session_id": session_id, "seq": segment.seq}
        # a condition, not only a check before: on databases with row locks two writers may both have checked
        if not self._write(_ADVANCE, {"session": session_id, "number": segment.seq}).rowcount:
            raise SequenceGapError(segment.seq, self.get(session_id).next_seq)
        self._write(
            _INSERT_SEGMENT,
            {
                **key,
                "content_hash": segment.content_hash,
                "n_samples": len(segment.samples),
                "t_start": float(segment.samples.t[0]),
                "t_end": float(segment.samples.t[-1]),
                "job_id": job_id,
                "received_at": now,
            },
        )
        samples = encode_samples(segment.samples)
        self._write(_INSERT_SAMPLES, {**key, "samples": samples, **encode_aids(segment.aids)})

    def get_segment(self, session_id: str, seq: int) -> SegmentInfo:
        """One segment, without its samples."""
        row = self._one("segment", f"{session_id}/{seq}", _GET_SEGMENT, {"session": session_id, "number": seq})
        return _segment(row)

    def get_result(self, session_id: str, seq: int) -> SegmentResult:
        """A segment with all of its fixes."""
        row = self._one("segment", f"{session_id}/{seq}", _GET_SEGMENT, {"session": session_id, "number": seq})
        filtered, lagged = (self._told_with(row, kind) for kind in (FixKind.FILTERED, FixKind.FIXED_LAG))
        return SegmentResult(_segment(row), filtered, lagged)

    def list_segments(self, session_id: str, *, cursor: str | None, limit: int) -> Page[SegmentInfo]:
        """Segments, oldest first; the cursor is the last ``seq`` seen."""
        statement = _SEGMENTS.where(segments.c.session_id == session_id)
        if cursor is not None:
            statement = statement.where(segments.c.seq > int(cursor))
        rows = self._read(statement.order_by(segments.c.seq).limit(limit + 1)).all()
        return page(rows, _segment, lambda row: str(row.seq), limit=limit)

    def last_segment(self, session_id: str) -> SegmentInfo | None:
        """The newest segment, if there is one."""
        row = self._read(_LAST_SEGMENT, {"session": session_id}).one_or_none()
        return None if row is None else _segment(row)

    def load_segment(self, session_id: str, seq: int) -> Recording:
        """Samples of a segment."""
        row = self._one("segment", f"{session_id}/{seq}", _LOAD_SEGMENT, {"session": session_id, "number": seq})
        return _recording(row)

    def load_segments(self, session_id: str, limit: int) -> Sequence[Recording]:
        """Samples of the first ``limit`` segments whose job is done, oldest first."""
        rows = self._read(_LOAD_DONE_SEGMENTS, {"session": session_id, "count": limit})
        return tuple(_recording(row) for row in rows)

    def state(self, session_id: str) -> TrackerState | None:
        """Tracker state after the last processed segment; None before the first."""
        row = self._read(_GET_STATE, {"session": session_id}).one_or_none()
        return None if row is None else TrackerState(row.method, row.payload, row.last_t)

    def learned(self, session_id: str) -> DeviceCalibration | None:
        """What the session learned last about its device."""
        values = self._read(_GET_CALIBRATION, {"session": session_id}).scalar()
        return None if values is None else calibration_from(values)

    def mark_remembered(self, session_id: str, now: datetime) -> bool:
        """Note that what the session learned is in its device's memory; False if that was noted before."""
        return self._write(_MARK_REMEMBERED, {"session": session_id, "now": now}).rowcount > 0

    def record_result(
        self,
        session_id: str,
        seq: int,
        state: TrackerState,
        fixes: Sequence[Fix],
        now: datetime,
        *,
        lagged: Sequence[Fix] = (),
        calibration: DeviceCalibration | None = None,
    ) -> SessionStatus:
        """Store new state, fixes of both kinds and calibration (None: it stays), and mark the segment processed.

        Returns whether the session is open still; until the transaction ends nobody else changes that.
        """
        row = self._one("session", session_id, _LAST_NUMBERS, {"session": session_id})
        first, lagged_first = (0 if last is None else last + 1 for last in (row.number, row.lagged_number))
        for statement, start, told in ((_INSERT_FIXES, first, fixes), (_INSERT_LAGGED, lagged_first, lagged)):
            if told:
                self._write(statement, [_columns(session_id, start + i, seq, fix) for i, fix in enumerate(told)])
        self._set_state(session_id, state, calibration)
        ranges = {"first": first, "count": len(fixes), "lagged_first": lagged_first, "lagged_count": len(lagged)}
        marked = self._write(_MARK_PROCESSED, {"session": session_id, "number": seq, "now": now, **ranges})
        expect_one(marked, "segment", f"{session_id}/{seq}")
        return SessionStatus(row.status)

    def record_failure(self, session_id: str, seq: int, error: str, now: datetime) -> None:
        """Mark the segment as one that gave no fixes; the state stays as it was."""
        marked = self._write(_MARK_FAILED, {"session": session_id, "number": seq, "now": now, "message": error})
        expect_one(marked, "segment", f"{session_id}/{seq}")

    def list_positions(
        self,
        session_id: str,
        *,
        seq: int | None,
        cursor: str | None,
        limit: int,
        kind: FixKind = FixKind.FILTERED,
    ) -> Page[Position]:
        """Fixes of a kind that is stored, in time order; the cursor is the ``number`` of the last one seen."""
        table = _TABLES[kind]
        statement = select(table).where(table.c.session_id == session_id)
        if seq is not None:
            row = self._one("segment", f"{session_id}/{seq}", _GET_SEGMENT, {"session": session_id, "number": seq})
            first, end = _range(row, kind)
            statement = statement.where(table.c.number >= first, table.c.number < end)
        if cursor is not None:
            statement = statement.where(table.c.number > int(cursor))
        rows = self._read(statement.order_by(table.c.number).limit(limit + 1)).all()
        return page(rows, partial(position_of, kind=kind), lambda row: str(row.number), limit=limit)

    def last_known(
        self,
        *,
        venue_id: str | None,
        level_id: str | None,
        limit: int,
        only: Sequence[str] | None = None,
    ) -> Sequence[LastKnown]:
        """Sessions with their last fixes, newest first: the open ones, or ``only`` these whether open or not."""
        statement = _LAST_KNOWN
        if only is None:
            statement = statement.where(sessions.c.status == SessionStatus.OPEN.value)
        else:
            statement = statement.where(sessions.c.id.in_(only))
        if venue_id is not None:
            statement = statement.where(sessions.c.venue_id == venue_id)
        if level_id is not None:
            statement = statement.where(func.coalesce(fixes.c.level_id, sessions.c.level_id) == level_id)
        rows = self._read(statement.order_by(sessions.c.id.desc()).limit(limit)).all()
        return tuple(_last_known(row) for row in rows)

    def _told_with(self, segment: Row[Any], kind: FixKind) -> tuple[Fix, ...]:
        first, end = _range(segment, kind)
        if first == end:
            return ()
        rows = self._read(_FIXES_OF[kind], {"session": segment.session_id, "first": first, "end": end})
        return tuple(position_of(row, kind).fix for row in rows)

    def _set_state(self, session_id: str, state: TrackerState, calibration: DeviceCalibration | None) -> None:
        values: dict[str, Any] = {"method": state.method, "payload": state.payload, "last_t": state.last_t}
        if calibration is not None:
            values["calibration"] = asdict(calibration)
        new = {f"new_{name}": value for name, value in values.items()}
        statement = _UPDATE_STATE if calibration is None else _UPDATE_STATE_AND_CALIBRATION
        if not self._write(statement, {"session": session_id, **new}).rowcount:
            self._write(_INSERT_STATE, {"session_id": session_id, **values})


def _session(row: Row[Any]) -> Session:
    return Session(
        id=row.id,
        venue_id=row.venue_id,
        level_id=row.level_id,
        maps=tuple(LevelMap(*one) for one in row.maps),
        device_id=row.device_id,
        method=row.method,
        parameters=row.parameters,
        prior=prior_from(row.prior),
        status=SessionStatus(row.status),
        next_seq=row.next_seq,
        created_at=row.created_at,
        closed_at=row.closed_at,
        calibration_epoch=row.calibration_epoch,
        method_reason=row.method_reason,
        contributor=row.contributor,
    )


def _segment(row: Row[Any]) -> SegmentInfo:
    return SegmentInfo(
        session_id=row.session_id,
        seq=row.seq,
        content_hash=row.content_hash,
        n_samples=row.n_samples,
        t_start=row.t_start,
        t_end=row.t_end,
        job_id=row.job_id,
        job_state=JobState(row.job_state),
        error=row.error,
        received_at=row.received_at,
        processed_at=row.processed_at,
    )


def _recording(row: Row[Any]) -> Recording:
    return Recording(decode_samples(row.samples), decode_aids(row._asdict()))


def _columns(session_id: str, number: int, seq: int, fix: Fix) -> dict[str, Any]:
    return {
        "session_id": session_id,
        "number": number,
        "seq": seq,
        "t": fix.t,
        "level_id": fix.level_id,
        "x": fix.x,
        "y": fix.y,
        "cov_xx": fix.cov_xx,
        "cov_xy": fix.cov_xy,
        "cov_yy": fix.cov_yy,
        "heading": fix.heading,
        "status": fix.status,
        "quality": fix.quality,
        "sure": fix.sure,
        "walk_on_m": fix.walk_on_m,
        "hypotheses": [astuple(h) for h in fix.hypotheses] or None,
    }


def _range(segment: Row[Any], kind: FixKind) -> tuple[int, int]:
    """Numbers of the fixes that were told with a segment: the first, and the one after the last."""
    lagged = kind is FixKind.FIXED_LAG
    first, n = (segment.first_lagged, segment.n_lagged) if lagged else (segment.first_fix, segment.n_fixes)
    return (0, 0) if first is None else (first, first + n)


def _last_known(row: Row[Any]) -> LastKnown:
    values = {column.name: row._mapping[f"fix_{column.name}"] for column in fixes.c}
    position = None if values["number"] is None else _position_of(values, FixKind.FILTERED)
    return LastKnown(_session(row), position)


def position_of(row: Row[Any], kind: FixKind) -> Position:
    """A fix of this kind from its row."""
    return _position_of(row._asdict(), kind)


def _position_of(values: Mapping[str, Any], kind: FixKind) -> Position:
    level_id = values["level_id"]
    fix = Fix(
        t=values["t"],
        level_id=level_id,
        x=values["x"],
        y=values["y"],
        cov_xx=values["cov_xx"],
        cov_xy=values["cov_xy"],
        cov_yy=values["cov_yy"],
        heading=values["heading"],
        status=Status(values["status"]),
        quality=values["quality"],
        sure=values["sure"],
        walk_on_m=values["walk_on_m"],
        hypotheses=tuple(_hypothesis(level_id, one) for one in values["hypotheses"] or ()),
        kind=kind,
    )
    return Position(values["session_id"], values["number"], values["seq"], fix)


def _hypothesis(level_id: str, values: Sequence[Any]) -> Hypothesis:
    """A stored hypothesis; before a search knew several levels they were all on the fix's and named none."""
    return Hypothesis(*values) if isinstance(values[0], str) else Hypothesis(level_id, *values)
