"""Answers to segments."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any, Self

from pydantic import Field

from app.api.schemas.base import Out, PageOut, Time, example
from app.api.schemas.fixes import (
    FIXED_LAG,
    FIXED_LAG_EXAMPLE,
    FIXES_EXAMPLE,
    POSITION_EXAMPLE,
    FixesOut,
    PositionOut,
    fix_columns,
    position_object,
)
from app.api.schemas.jobs import JOB_ID
from app.api.schemas.sessions import SESSION_ID
from app.engine.types import Fix
from app.services import records
from app.services.records import JobState

_INFO: dict[str, Any] = {
    "session_id": SESSION_ID,
    "seq": 0,
    "state": "done",
    "error": None,
    "job_id": JOB_ID,
    "n_samples": 250,
    "t_start_ms": 1764000000000.0,
    "t_end_ms": 1764000004980.0,
    "received_at": "2026-11-22T09:30:05.000Z",
    "processed_at": "2026-11-22T09:30:05.021Z",
}
SEGMENT_DONE: dict[str, Any] = {
    **_INFO,
    "seq": 1,
    "fixes": FIXES_EXAMPLE,
    "fixed_lag": FIXED_LAG_EXAMPLE,
    "position": POSITION_EXAMPLE,
}
SEGMENT_QUEUED: dict[str, Any] = {
    **_INFO,
    "state": "queued",
    "processed_at": None,
    "fixes": None,
    "fixed_lag": None,
    "position": None,
}


class SegmentInfoOut(Out):
    """Where a segment stands."""

    model_config = example(_INFO)

    session_id: str
    seq: int
    state: JobState
    error: Annotated[str | None, Field(description="Why there are no fixes; the session goes on.")]
    job_id: str
    n_samples: int
    t_start_ms: float
    t_end_ms: float
    received_at: Time
    processed_at: Time | None

    @classmethod
    def of(cls, info: records.SegmentInfo) -> Self:
        """Show a segment without its fixes."""
        return cls(**_plain(info))


class SegmentOut(SegmentInfoOut):
    """A segment and what came of it."""

    model_config = example(SEGMENT_DONE)

    fixes: FixesOut | None
    fixed_lag: Annotated[FixesOut | None, Field(description=FIXED_LAG)]
    position: Annotated[PositionOut | None, Field(description="The last fix.")]


class SegmentPage(PageOut):
    """Segments of a session, oldest first."""

    model_config = example({"items": [_INFO], "next_cursor": None})

    items: list[SegmentInfoOut]


def segment_object(info: records.SegmentInfo, fixes: Sequence[Fix] = (), lagged: Sequence[Fix] = ()) -> dict[str, Any]:
    """Return a segment with its fixes as plain values, the shape of SegmentOut."""
    done = info.job_state is JobState.DONE
    return {
        **SegmentInfoOut.of(info).model_dump(mode="json"),
        "fixes": fix_columns(fixes) if done else None,
        "fixed_lag": fix_columns(lagged) if done else None,
        "position": position_object(fixes[-1]) if done and fixes else None,
    }


def _plain(info: records.SegmentInfo) -> dict[str, Any]:
    return {
        "session_id": info.session_id,
        "seq": info.seq,
        "state": info.job_state,
        "error": info.error,
        "job_id": info.job_id,
        "n_samples": info.n_samples,
        "t_start_ms": round(info.t_start * 1000.0, 3),
        "t_end_ms": round(info.t_end * 1000.0, 3),
        "received_at": info.received_at,
        "processed_at": info.processed_at,
    }
