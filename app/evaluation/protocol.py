"""What is replayed: scenarios, priors, segments. Everything here is a function of the walk, so runs repeat.

| scenario | prior given |
|---|---|
| ``tracking`` | the first waypoint, displaced by up to 3 m; heading unknown |
| ``cold`` | the level |
| ``venue`` | the building: the map source holds all its levels in the data folder, the prior names none |
| ``pose`` | the first waypoint and the direction of the first leg (data sets whose published results had both) |
"""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path

import numpy as np

from app.engine.types import Float64Array, ImuSamples, MapBuildSettings, Prior, RadioScans, Segment
from app.evaluation.datasets.walks import RadioLog, RecordedWalk
from app.evaluation.errors import OptionsError

SEGMENT_S = 5.0
SHORTEST_SEGMENT_S = 1.0
"""A shorter remainder at the end of a walk joins the segment before it."""
PRIOR_RADIUS_M = 3.0
LABEL_LEAD_S = 0.5
POSE_RADIUS_M = 0.5
POSE_HEADING_SD = 0.1
"""rad"""
NO_AIDS = "none"


class Scenario(StrEnum):
    """What is known before the first segment."""

    TRACKING = "tracking"
    COLD = "cold"
    VENUE = "venue"
    POSE = "pose"


@dataclass(frozen=True, slots=True)
class Aids:
    """What is sent beside the magnetometer and inertial samples, with survey walks and with segments."""

    wifi: bool = False
    ble: bool = False

    @classmethod
    def parse(cls, text: str) -> Aids:
        """From names separated by commas, or ``none``; raises :class:`OptionsError` for any other."""
        names = {name.strip() for name in text.split(",") if name.strip()} - {NO_AIDS}
        unknown = names - {"wifi", "ble"}
        if unknown:
            raise OptionsError("aids", f"knows no {', '.join(sorted(unknown))}; name {NO_AIDS}, wifi, ble or wifi,ble")
        return cls(wifi="wifi" in names, ble="ble" in names)

    def __bool__(self) -> bool:
        return self.wifi or self.ble

    def __str__(self) -> str:
        return ",".join(name for name in ("wifi", "ble") if getattr(self, name)) or NO_AIDS


class Through(StrEnum):
    """Where the walks are replayed."""

    ENGINE = "engine"
    HTTP = "http"


@dataclass(frozen=True, slots=True)
class EvaluationOptions:
    """What to evaluate, and how.

    Attributes
    ----------
    data : Path
        Folder that holds ``ilc20/``.
    levels : tuple of str
        Names of levels; empty: all that are found.
    scenario, aids, through
    jobs : int
        Processes (threads with ``through=http``) that replay walks side by side.
    plots, cache : Path or None
        Folders for plots, and for built maps to be used again (by content); None: neither.
    method, parameters
        Tracker of the registry (empty: its default), and its parameters.
    map_settings : MapBuildSettings
    limit : int or None
        At most so many test walks a level, the first of the file.
    repeat : int
        Another number draws other priors and tracker seeds.
    """

    data: Path
    levels: tuple[str, ...] = ()
    scenario: Scenario = Scenario.TRACKING
    aids: Aids = Aids()
    through: Through = Through.ENGINE
    jobs: int = 1
    plots: Path | None = None
    cache: Path | None = None
    method: str = ""
    parameters: dict[str, object] = field(default_factory=dict)
    map_settings: MapBuildSettings = field(default_factory=MapBuildSettings)
    limit: int | None = None
    repeat: int = 0

    def __post_init__(self) -> None:
        if self.jobs < 1:
            raise OptionsError("jobs", f"needs at least 1, got {self.jobs}")
        if self.limit is not None and self.limit < 1:
            raise OptionsError("limit", f"needs at least 1, got {self.limit}")


@dataclass(frozen=True, slots=True)
class Trip:
    """One walk as the service would get it: prior and segments, no truth.

    ``level_id`` and ``venue_id`` are where it took place, as the driver calls them; the prior says what of it is told.
    """

    walk_id: str
    level_id: str
    venue_id: str
    prior: Prior
    seed: int
    segments: tuple[Segment, ...]

    @property
    def start_t(self) -> float:
        """Time of the first sample, s."""
        return float(self.segments[0].samples.t[0])


def make_trip(
    walk: RecordedWalk,
    level_id: str,
    scenario: Scenario,
    *,
    venue_id: str = "",
    aids: Aids = Aids(),
    repeat: int = 0,
) -> Trip:
    """The trip of a recorded walk under a scenario."""
    seed = walk_seed(walk.walk_id, repeat)
    return Trip(
        walk_id=walk.walk_id,
        level_id=level_id,
        venue_id=venue_id,
        prior=make_prior(walk, level_id, scenario, seed),
        seed=seed,
        segments=cut_segments(walk, aids),
    )


def walk_seed(walk_id: str, repeat: int = 0) -> int:
    """Seed of a walk: the first 63 bits of the SHA-256 of its id."""
    text = walk_id if repeat == 0 else f"{walk_id}/{repeat}"
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "big") >> 1


def make_prior(walk: RecordedWalk, level_id: str, scenario: Scenario, seed: int) -> Prior:
    """What the scenario tells about the start of the walk."""
    if scenario is Scenario.VENUE:
        return Prior(None)
    if scenario is Scenario.COLD:
        return Prior(level_id)
    if scenario is Scenario.POSE:
        return _pose(walk, level_id)
    rng = np.random.default_rng(seed)
    distance = PRIOR_RADIUS_M * math.sqrt(rng.uniform())  # uniform over the disc's area
    bearing = rng.uniform(0.0, 2.0 * math.pi)
    return Prior(
        level_id,
        x=float(walk.waypoints.x[0]) + distance * math.cos(bearing),
        y=float(walk.waypoints.y[0]) + distance * math.sin(bearing),
        radius_m=PRIOR_RADIUS_M,
    )


def _pose(walk: RecordedWalk, level_id: str) -> Prior:
    x, y = walk.waypoints.x, walk.waypoints.y
    return Prior(
        level_id,
        x=float(x[0]),
        y=float(y[0]),
        radius_m=POSE_RADIUS_M,
        heading=math.atan2(float(y[1] - y[0]), float(x[1] - x[0])),
        heading_sd=POSE_HEADING_SD,
    )


def cut_segments(walk: RecordedWalk, aids: Aids = Aids()) -> tuple[Segment, ...]:
    """Segments of ``SEGMENT_S``, from the first label on (the prior speaks of that moment)."""
    samples = walk.samples
    first = int(np.searchsorted(samples.t, walk.waypoints.t[0] - LABEL_LEAD_S))
    t = samples.t[first:]
    if not len(t):
        return ()
    edges = first + segment_edges(t)
    wifi, ble = (walk.wifi_log if aids.wifi else None), (walk.ble_log if aids.ble else None)
    return tuple(
        Segment(_rows(samples, slice(a, b)), wifi=_heard(wifi, samples.t, a, b), ble=_heard(ble, samples.t, a, b))
        for a, b in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True)
    )


def segment_edges(t: Float64Array) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    """Row at which each segment begins, and the end of the last one; no segment is empty."""
    cuts = np.arange(t[0] + SEGMENT_S, t[-1], SEGMENT_S)
    if len(cuts) and t[-1] - cuts[-1] < SHORTEST_SEGMENT_S:
        cuts = cuts[:-1]
    return np.unique(np.concatenate(([0], np.searchsorted(t, cuts), [len(t)]))).astype(np.int64)


def _rows(samples: ImuSamples, rows: slice) -> ImuSamples:
    return ImuSamples(samples.t[rows], samples.mag[rows], samples.acc[rows], samples.gyro[rows])


def _heard(log: RadioLog | None, t: Float64Array, start: int, end: int) -> RadioScans | None:
    """Readings that the phone had reported by the end of the segment, and not before its start."""
    if log is None:
        return None
    after = -math.inf if start == 0 else float(t[start - 1])
    return log.between(after, float(t[end - 1]))
