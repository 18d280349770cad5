"""Answers that hold fixes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Literal

from pydantic import ConfigDict, PlainValidator

from isodyn_client.fixes import FixColumns, Fixes
from isodyn_client.models import JobState, LevelMap, Model, Position, Status


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


class Distances(Model):
    """Distances of ``n`` pairs of fixes, m."""

    n: int
    p50: float
    p90: float
    largest: float


class FixComparison(Model):
    """What was told then and what is told now, fix by fix where their times agree; shares are 0 to 1."""

    n_then: int
    n_now: int
    n_compared: int
    n_other_level: int
    distance: Distances | None = None
    sure_distance: Distances | None = None
    status_then: Mapping[Status, float] = {}
    status_now: Mapping[Status, float] = {}
    sure_then: float
    sure_now: float


class Replay(_WithFixes):
    """A session's fixes on other maps, and how they compare with those that were told on ``maps_then``."""

    session_id: str
    map_id: str | None = None
    maps: tuple[LevelMap, ...] = ()
    maps_then: tuple[LevelMap, ...] = ()
    method: str
    fixes: FixArrays
    comparison: FixComparison


class PositionPage(_WithFixes):
    """One page of a session's fixes of a kind; ``number`` counts them, ``seq`` is the segment each was told with."""

    number: tuple[int, ...] = ()
    seq: tuple[int, ...] = ()
    fixes: FixArrays
    next_cursor: str | None = None
