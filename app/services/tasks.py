"""What crosses the boundary to a worker: values and map hashes, never a database handle.

A task is a module-level function of :mod:`app.workers.tasks` that takes one spec and returns one result; specs and
results pickle.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from app.engine.mapping import FloorPlan, NewWalk
from app.engine.mapping.crowd.changes import ChangeEvent
from app.engine.mapping.crowd.weigh import Verdict
from app.engine.types import (
    DeviceCalibration,
    Evidence,
    Fix,
    MapBuild,
    MapBuildSettings,
    Prior,
    Progress,
    Segment,
    TrackerState,
)


@dataclass(frozen=True, slots=True)
class MapRef:
    """A map in the local cache: the worker memory-maps ``path`` and keeps it by ``hash``."""

    level_id: str
    hash: str
    path: Path


@dataclass(frozen=True, slots=True)
class LocateSpec:
    """Take one segment of a session (or a one-shot segment: ``state`` None)."""

    method: str
    parameters: Mapping[str, object]
    prior: Prior
    seed: int
    state: TrackerState | None
    segment: Segment
    maps: tuple[MapRef, ...]


@dataclass(frozen=True, slots=True)
class LocateResult:
    """New tracker state, the fixes of the segment, what the session has learned about its device so far, and the
    fixed-lag fixes of earlier steps."""

    state: TrackerState
    fixes: tuple[Fix, ...]
    cpu_s: float
    calibration: DeviceCalibration | None = None
    lagged: tuple[Fix, ...] = ()


@dataclass(frozen=True, slots=True)
class SmoothSpec:
    """Smooth the trajectory of a session over all these segments, oldest first."""

    method: str
    parameters: Mapping[str, object]
    prior: Prior
    seed: int
    segments: tuple[Segment, ...]
    maps: tuple[MapRef, ...]


@dataclass(frozen=True, slots=True)
class SmoothResult:
    """The smoothed fixes, one per step."""

    fixes: tuple[Fix, ...]
    cpu_s: float


@dataclass(frozen=True, slots=True)
class ReplaySpec:
    """Take all these segments of a session once more, oldest first, from its start."""

    method: str
    parameters: Mapping[str, object]
    prior: Prior
    seed: int
    segments: tuple[Segment, ...]
    maps: tuple[MapRef, ...]


@dataclass(frozen=True, slots=True)
class ReplayResult:
    """The fixes of all segments as they are told one after the other."""

    fixes: tuple[Fix, ...]
    cpu_s: float


@dataclass(frozen=True, slots=True)
class UpdateBase:
    """The version that an update starts from.

    Attributes
    ----------
    map_id : str
    map : MapRef
    evidence : Evidence
        Of the tiles that ``box`` touches.
    box : tuple of float, m
        What the update can change, with what that rests on.
    model : mapping
        Plain values of the version's model.
    removed : tuple of str
        Sources to take out.
    contributed : Evidence or None
        Rows of sessions to add.
    added : tuple of str
        Ids of the contributions these are of, also of those without rows.
    reputation : mapping
        What other levels tell of contributors, 0 to 1.
    """

    map_id: str
    map: MapRef
    evidence: Evidence
    box: tuple[float, float, float, float]
    model: Mapping[str, object]
    removed: tuple[str, ...] = ()
    contributed: Evidence | None = None
    added: tuple[str, ...] = ()
    reputation: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class BuildSpec:
    """Build a map of one level, or bring one up to date (``base``) by these walks."""

    level_id: str
    walks: tuple[NewWalk, ...]
    settings: MapBuildSettings
    plan: FloorPlan | None = None
    base: UpdateBase | None = None


@dataclass(frozen=True, slots=True)
class BuildResult:
    """The built map. Of an update: the evidence is that of ``base.box``, reports are of the new walks, and there are
    verdicts on contributions in the box and changes of the field there."""

    build: MapBuild
    cpu_s: float
    base: UpdateBase | None = None
    verdicts: tuple[Verdict, ...] = ()
    changes: tuple[ChangeEvent, ...] = ()


@dataclass(frozen=True, slots=True)
class ContributeSpec:
    """Smooth a session and take from it what the map of its level can use."""

    contribution_id: str
    contributor: str
    device: str
    smooth: SmoothSpec
    calibration: DeviceCalibration | None = None


@dataclass(frozen=True, slots=True)
class Offer:
    """What a session offers to one level's map: rows (none, if nothing was sure enough), and why not more."""

    level_id: str
    evidence: Evidence
    n_steps: int
    n_kept: int
    reasons: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class ContributeResult:
    """The offers of a session."""

    offers: tuple[Offer, ...]
    cpu_s: float


ContributeTask = Callable[[ContributeSpec, Progress], ContributeResult]
LocateTask = Callable[[LocateSpec, Progress], LocateResult]
SmoothTask = Callable[[SmoothSpec, Progress], SmoothResult]
ReplayTask = Callable[[ReplaySpec, Progress], ReplayResult]
BuildTask = Callable[[BuildSpec, Progress], BuildResult]
