"""Walks, trackers and services that are made up, for tests of the evaluation itself. All picklable."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from app.engine.errors import InputError, MapError
from app.engine.types import (
    FeatureSet,
    Fix,
    GridMap,
    ImuSamples,
    MapBuildSettings,
    MapSource,
    Prior,
    Progress,
    Segment,
    Status,
    SurveyWalk,
    TrackerState,
    Waypoints,
)
from app.evaluation.datasets.ilc20 import RecordedWalk
from app.evaluation.drivers import FieldRaster, LevelUpload
from app.evaluation.errors import TransportError
from app.evaluation.prepare import PreparedLevel, PrepareTask, surveyed_area
from app.evaluation.protocol import Trip
from app.evaluation.through_engine import Engine

START_MS = 1_574_568_594_892
PACE_S = 0.55
STRIDE_M = 0.7


def fix(
    t: float, x: float = 0.0, y: float = 0.0, *, sd: float = 1.0, level: str = "site-F1", sure: bool = True,
    status: Status = Status.OK,
) -> Fix:  # fmt: skip
    return Fix(t, level, x, y, sd**2, 0.0, sd**2, 0.0, status, 0.9, sure)


def step_samples(
    duration_s: float, *, pause: tuple[float, float] | None = None, start: float = START_MS / 1000
) -> ImuSamples:
    """A phone held flat: one bounce of the specific force every ``PACE_S``, none during the pause."""
    since = np.arange(0.0, duration_s, 0.02)
    bounce = 3.0 * np.sin(2 * np.pi * since / PACE_S)
    if pause:
        bounce[(since >= pause[0]) & (since < pause[1])] = 0.0
    n = len(since)
    acc = np.column_stack((np.zeros(n), np.zeros(n), 9.81 + bounce))
    return ImuSamples(np.round(start + since, 3), np.tile([0.0, 20.0, -40.0], (n, 1)), acc, np.zeros((n, 3)))


def straight_walk(
    walk_id: str = "w", *, duration_s: float = 30.0, y: float = 2.0, split: str = "test", start: float = START_MS / 1000
) -> RecordedWalk:
    """Along +x from x = 0, labelled at both ends."""
    samples = step_samples(duration_s, start=start)
    length = STRIDE_M * duration_s / PACE_S
    waypoints = Waypoints(
        np.array([samples.t[0] - 0.1, samples.t[-1] - 0.5]), np.array([0.0, length]), np.array([y, y])
    )
    return RecordedWalk(walk_id, split, samples, waypoints, None, "ACME One", length)


def write_level(
    folder: Path,
    walks: Sequence[RecordedWalk],
    *,
    wifi: Mapping[str, Sequence[tuple[int, str, int, int]]] | None = None,
    ble: Mapping[str, Sequence[tuple[int, str, int]]] | None = None,
) -> None:
    """Write walks in the ilc20 folder format (only the required columns and files)."""
    folder.mkdir(parents=True)
    (folder / "floor.json").write_text(json.dumps({"width_m": 60.0, "height_m": 40.0}))
    counts = [len(walk.samples) for walk in walks]
    starts = [round(walk.samples.t[0] * 1000) for walk in walks]
    traces = {
        "trace_id": [walk.walk_id for walk in walks],
        "row_start": np.cumsum([0, *counts[:-1]]),
        "n_samples": counts,
        "split": [walk.split for walk in walks],
        "start_unix_ms": starts,
    }
    pq.write_table(pa.table(traces), folder / "traces.parquet")
    t = [np.round(w.samples.t * 1000 - s).astype(np.int32) for w, s in zip(walks, starts, strict=True)]
    columns = {"t": np.concatenate(t)}
    for sensor, name in (("m", "mag"), ("a", "acc"), ("g", "gyro")):
        values = np.concatenate([getattr(walk.samples, name) for walk in walks]).astype(np.float32)
        columns |= {sensor + axis: values[:, i] for i, axis in enumerate("xyz")}
    pq.write_table(pa.table(columns), folder / "imu.parquet")
    labels = [
        (w.walk_id, round(float(lt) * 1000 - s), float(x), float(y))
        for w, s in zip(walks, starts, strict=True)
        for lt, x, y in zip(w.waypoints.t, w.waypoints.x, w.waypoints.y, strict=True)
    ]
    names = ("trace_id", "t", "x", "y")
    pq.write_table(pa.table({n: [row[i] for row in labels] for i, n in enumerate(names)}), folder / "waypoints.parquet")
    if wifi is not None:
        rows = [(walk_id, *row) for walk_id, scans in wifi.items() for row in scans]
        names = ("trace_id", "t", "bssid", "rssi", "age_ms")
        pq.write_table(pa.table({n: [row[i] for row in rows] for i, n in enumerate(names)}), folder / "wifi.parquet")
    if ble is not None:
        rows = [(walk_id, *row) for walk_id, heard in ble.items() for row in heard]
        names = ("trace_id", "t", "mac", "rssi")
        pq.write_table(pa.table({n: [row[i] for row in rows] for i, n in enumerate(names)}), folder / "beacon.parquet")


def flat_map(level_id: str) -> GridMap:
    shape = (30, 50)
    mean = np.broadcast_to(np.array([0.0, 20.0, -40.0], dtype=np.float32)[:, None, None], (3, *shape)).copy()
    support = np.zeros(shape, dtype=np.float32)
    support[:, 40:] = 9.0
    return GridMap(
        level_id, FeatureSet.VECTOR, -2.0, -2.0, 1.0, mean, np.ones((3, *shape), np.float32), support, 1.5, (2.0,) * 3
    )


def prepare_flat(task: PrepareTask) -> PreparedLevel:
    """Stands for ``prepare_level``: the surveyed area is real, the map is flat."""
    area = surveyed_area(task.walks)
    if not task.walks:
        return PreparedLevel(task.name, None, area, 0, problem="no walks")
    return PreparedLevel(task.name, flat_map(task.name) if task.with_map else None, area, len(task.walks), build_s=0.5)


@dataclass(frozen=True)
class DriftingTracker:
    """One fix a second that walks along +x from the prior and strays at random; the state carries the seed."""

    pace: float = STRIDE_M / PACE_S
    hears: bool = False

    def start(self, prior: Prior, *, seed: int) -> TrackerState:
        if prior.x is None:
            raise InputError("prior", "needs a position")
        return TrackerState("drifting", json.dumps([prior.level_id, prior.x, prior.y, seed]).encode())

    def step(
        self, state: TrackerState, segment: Segment, map_source: MapSource
    ) -> tuple[TrackerState, tuple[Fix, ...]]:
        level, x, y, seed = json.loads(state.payload)
        map_source.grid_map(level)
        rng = np.random.default_rng(seed)
        fixes = []
        for t in np.arange(segment.samples.t[0], segment.samples.t[-1], 1.0):
            x += self.pace + rng.normal(0.0, 0.1)
            y += rng.normal(0.0, 0.1) + (0.5 if self.hears and (segment.wifi or segment.ble) else 0.0)
            fixes.append(fix(float(t), x, y, sd=2.0, level=level))
        payload = json.dumps([level, x, y, int(rng.integers(2**62))]).encode()
        return TrackerState("drifting", payload, float(segment.samples.t[-1])), tuple(fixes)


@dataclass(frozen=True)
class ClueLessTracker:
    """Answers any prior with one honest fix a segment that claims nothing."""

    def start(self, prior: Prior, *, seed: int) -> TrackerState:
        return TrackerState("clueless", (prior.level_id or "").encode())

    def step(
        self, state: TrackerState, segment: Segment, map_source: MapSource
    ) -> tuple[TrackerState, tuple[Fix, ...]]:
        end = float(segment.samples.t[-1])
        level = state.payload.decode() or map_source.level_ids()[0]
        return state, (fix(end, 25.0, 15.0, sd=30.0, level=level, sure=False, status=Status.INSUFFICIENT),)


@dataclass(frozen=True)
class FailingTracker:
    """Refuses every second segment."""

    def start(self, prior: Prior, *, seed: int) -> TrackerState:
        return TrackerState("failing", b"0")

    def step(
        self, state: TrackerState, segment: Segment, map_source: MapSource
    ) -> tuple[TrackerState, tuple[Fix, ...]]:
        if round(float(segment.samples.t[0]) / 5.0) % 2:
            raise MapError("not today")
        return state, (fix(float(segment.samples.t[0])),)


TRACKERS: dict[str, Callable[..., object]] = {
    "drifting": DriftingTracker,
    "dead_reckoning": DriftingTracker,
    "clueless": ClueLessTracker,
    "failing": FailingTracker,
}


def create_tracker(name: str, parameters: Mapping[str, object]) -> DriftingTracker | ClueLessTracker | FailingTracker:
    if name not in TRACKERS:
        raise InputError("method", f"no method {name!r}")
    try:
        return TRACKERS[name](**parameters)  # type: ignore[return-value]
    except TypeError as error:
        raise InputError("parameters", str(error)) from error


def no_warm_up() -> None:
    return


def smooth_to_one_place(tracker: object, trip: Trip, map_source: MapSource) -> tuple[Fix, ...]:
    """Stands for a smoother: the whole trip at one place."""
    return (fix(trip.start_t, 10.0, 2.0, level=trip.level_id),)


def refuse_to_smooth(tracker: object, trip: Trip, map_source: MapSource) -> tuple[Fix, ...]:
    raise MapError("too short")


FAKE_ENGINE = Engine(create_tracker, "drifting", no_warm_up, prepare_flat)


@dataclass
class FakeService:
    """A service in memory: checks the order of calls and answers with the drifting tracker."""

    refuse_seq: int | None = None
    levels: list[LevelUpload] = field(default_factory=list)
    walks: dict[str, int] = field(default_factory=dict)
    built: set[str] = field(default_factory=set)
    sessions: dict[str, tuple[DriftingTracker, TrackerState, int]] = field(default_factory=dict)
    methods: list[str] = field(default_factory=list)
    venues: list[str] = field(default_factory=list)
    located: list[Segment] = field(default_factory=list)
    closed: int = 0

    def add_level(self, level: LevelUpload) -> str:
        self.levels.append(level)
        return f"lvl_{len(self.levels)}"

    def add_walks(self, level_id: str, walks: Sequence[SurveyWalk], progress: Progress) -> None:
        self.walks[level_id] = len(walks)
        progress(1.0, "walks")

    def build_map(self, level_id: str, settings: MapBuildSettings, progress: Progress) -> None:
        assert self.walks[level_id]
        self.built.add(level_id)
        progress(1.0, "map")

    def field_raster(self, level_id: str) -> FieldRaster | None:
        return FieldRaster.of(flat_map(level_id))

    def venue_of(self, level_id: str) -> str:
        return f"ven_{self.levels[int(level_id.removeprefix('lvl_')) - 1].site}"

    def open_session(self, prior: Prior, venue_id: str, *, method: str, parameters: Mapping[str, object]) -> str:
        tracker = DriftingTracker(**parameters)  # type: ignore[arg-type]
        name = f"ses_{len(self.sessions)}"
        self.sessions[name] = (tracker, tracker.start(self._told(prior, venue_id), seed=len(self.sessions)), 0)
        self.venues.append(venue_id)
        self.methods.append(method)
        return name

    def send_segment(self, session_id: str, seq: int, segment: Segment) -> Sequence[Fix]:
        tracker, state, expected = self.sessions[session_id]
        if seq != expected:
            raise TransportError(f"seq {seq}, expected {expected}")
        if seq == self.refuse_seq and len(segment.samples) != 1:
            self.refuse_seq = None
            raise TransportError("overloaded")
        source = MapsOf(tuple(self.built))
        state, fixes = tracker.step(state, segment, source)
        self.sessions[session_id] = (tracker, state, seq + 1)
        return fixes

    def close_session(self, session_id: str) -> None:
        self.closed += 1

    def locate(
        self, prior: Prior, venue_id: str, segment: Segment, *, method: str, parameters: Mapping[str, object]
    ) -> Sequence[Fix]:
        self.located.append(segment)
        tracker = DriftingTracker(**parameters)  # type: ignore[arg-type]
        return tracker.step(tracker.start(self._told(prior, venue_id), seed=1), segment, MapsOf(tuple(self.built)))[1]

    def _told(self, prior: Prior, venue_id: str) -> Prior:
        """The drifting tracker needs a place: in a venue it is told the highest level and a corner of it."""
        if prior.level_id is not None:
            assert prior.level_id in self.built
            return prior
        mapped = [level_id for level_id in sorted(self.built) if self.venue_of(level_id) == venue_id]
        return Prior(mapped[-1], 0.0, 2.0)


@dataclass(frozen=True)
class MapsOf:
    names: tuple[str, ...]

    def level_ids(self) -> tuple[str, ...]:
        return self.names

    def grid_map(self, level_id: str) -> GridMap:
        if level_id not in self.names:
            raise MapError(f"no map of {level_id!r}")
        return flat_map(level_id)
