"""Answers that hold fixes."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import ConfigDict, PlainValidator

from isodyn_client.fixes import FixColumns, Fixes
from isodyn_client.models import JobState, LevelMap, Model, Position


def _as_fixes(value: object) -> Fixes:
    return value if isinstance(value, Fixes) else Fixes.from_columns(FixColumns.model_validate(value))


FixArrays = Annotated[Fixes, PlainValidator(_as_fixes)]
"""Fixes in columns on the wire, arrays here."""


class _WithFixes(Model):
    model_config = ConfigDict(arbitrary_types_allowed=True)


class SegmentInfo(_WithFixes):
    """Where a segment stands."""

    session_id: str
    seq: int
    state: JobState
    error: str | None = None
    job_id: str | None = None
    n_samples: int | None = None
    t_start_ms: float | None = None
    t_end_ms: float | None = None


class SegmentResult(SegmentInfo):
    """Where a segment stands; what came of it is there once it is processed.

    ``position`` is the last of the ``fixes``; ``fixed_lag`` are steps some seconds back, told once more with what came
    since, each step once.
    """

    fixes: FixArrays | None = None
    fixed_lag: FixArrays | None = None
    position: Position | None = None


class LocateResult(_WithFixes):
    """Answer to a one-shot location; ``fixed_lag`` as in :class:`SegmentResult`."""

    fixes: FixArrays
    fixed_lag: FixArrays
    position: Position | None = None
    map_id: str | None = None
    maps: tuple[LevelMap, ...] = ()
    method: str | None = None
    method_reason: str | None = None


class Trajectory(_WithFixes):
    """A session's smoothed trajectory as it is answered."""

    session_id: str
    map_id: str | None = None
    maps: tuple[LevelMap, ...] = ()
    method: str
    kind: Literal["smoothed"]
    fixes: FixArrays


class PositionPage(_WithFixes):
    """One page of a session's fixes of a kind; ``number`` counts them, ``seq`` is the segment each was told with."""

    number: tuple[int, ...] = ()
    seq: tuple[int, ...] = ()
    fixes: FixArrays
    next_cursor: str | None = None
