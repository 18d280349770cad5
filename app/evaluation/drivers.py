"""Drivers: replay a trip through the engine, or through a running service.

The HTTP side is a :class:`Transport` that the caller supplies (the command line makes one of the Python client), so
nothing here knows a web library.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from app.engine.errors import EngineError, MapError
from app.engine.localization.particle import ParticleTracker
from app.engine.localization.smoothing import smooth_session
from app.engine.types import (
    Fix,
    Float32Array,
    GridMap,
    MapBuildSettings,
    MapSource,
    Prior,
    Progress,
    Segment,
    SurveyWalk,
    Tracker,
)
from app.evaluation.errors import TransportError
from app.evaluation.protocol import Trip


@dataclass(frozen=True, slots=True)
class Replay:
    """What came back for one trip.

    Attributes
    ----------
    fixes : tuple of Fix
        In the order of arrival.
    segment_s : tuple of float, s
        Wall-clock time from handing a segment over to having its fixes; failed ones are not in it.
    failures : tuple of str
        One line per segment that was refused or failed; the trip goes on without it.
    """

    fixes: tuple[Fix, ...]
    segment_s: tuple[float, ...]
    failures: tuple[str, ...] = ()


class Driver(Protocol):
    """Replays trips, each from its start and independently of the others."""

    def replay(self, trip: Trip) -> Replay:
        """Send all segments of the trip in order."""
        ...


@dataclass(frozen=True, slots=True)
class GridMaps:
    """A map source over maps in memory."""

    maps: Mapping[str, GridMap]

    def level_ids(self) -> tuple[str, ...]:
        """Levels with a map."""
        return tuple(self.maps)

    def grid_map(self, level_id: str) -> GridMap:
        """Map of one level; raises :class:`MapError` if there is none."""
        if level_id not in self.maps:
            raise MapError(f"there is no map of level {level_id!r}")
        return self.maps[level_id]


@dataclass(frozen=True, slots=True)
class EngineDriver:
    """Calls a tracker directly."""

    tracker: Tracker
    map_source: MapSource

    def replay(self, trip: Trip) -> Replay:
        """Send all segments of the trip in order; a segment the engine refuses leaves the state as it was."""
        fixes: list[Fix] = []
        times: list[float] = []
        failures: list[str] = []
        try:
            state = self.tracker.start(trip.prior, seed=trip.seed)
        except EngineError as error:
            return Replay((), (), (f"start: {error}",))
        for seq, segment in enumerate(trip.segments):
            began = time.perf_counter()
            try:
                state, new = self.tracker.step(state, segment, self.map_source)
            except EngineError as error:
                failures.append(f"segment {seq}: {error}")
                continue
            times.append(time.perf_counter() - began)
            fixes.extend(new)
        return Replay(tuple(fixes), tuple(times), tuple(failures))


class Smoother(Protocol):
    """After-the-fact track of a trip, from all its segments at once."""

    def __call__(self, tracker: Tracker, trip: Trip, map_source: MapSource) -> Sequence[Fix] | None:
        """Fixes in time order, None if there is no smoother for this tracker.

        Raises :class:`EngineError` if the trip cannot be smoothed.
        """
        ...


def smooth_in_engine(tracker: Tracker, trip: Trip, map_source: MapSource) -> Sequence[Fix] | None:
    """The engine's smoother; only the particle tracker has one."""
    if not isinstance(tracker, ParticleTracker):
        return None
    return smooth_session(tracker, trip.prior, trip.segments, map_source, seed=trip.seed)


@dataclass(frozen=True, slots=True)
class LevelUpload:
    """A level as the service needs it. ``vector_plan`` is GeoJSON in level metres."""

    site: str
    name: str
    ordinal: int
    extent: tuple[float, float, float, float]
    plan_png: bytes | None
    vector_plan: Mapping[str, object] | None


@dataclass(frozen=True, slots=True)
class FieldRaster:
    """One channel of a map for drawing: node ``[r, c]`` at ``(x0 + c cell_m, y0 + r cell_m)``, NaN where unmapped."""

    x0: float
    y0: float
    cell_m: float
    values: Float32Array
    unit: str = "uT"

    @classmethod
    def of(cls, grid_map: GridMap) -> FieldRaster:
        """Magnitude of the mapped field."""
        magnitude = np.sqrt(np.sum(grid_map.mean.astype(np.float32) ** 2, axis=0))
        values = np.where(grid_map.mapped, magnitude, np.float32(np.nan))
        return cls(grid_map.x0, grid_map.y0, grid_map.cell_m, values.astype(np.float32))


class Transport(Protocol):
    """A running service, seen from the evaluation. Safe to use from several threads.

    Every method raises :class:`TransportError` when the service refuses or cannot be reached.
    """

    def add_level(self, level: LevelUpload) -> str:
        """Create the level (and its venue, once per ``site``) with its plans; returns the level's id."""
        ...

    def add_walks(self, level_id: str, walks: Sequence[SurveyWalk], progress: Progress) -> None:
        """Upload survey walks."""
        ...

    def build_map(self, level_id: str, settings: MapBuildSettings, progress: Progress) -> None:
        """Build the level's map and wait for it."""
        ...

    def field_raster(self, level_id: str) -> FieldRaster | None:
        """The map for drawing; None if the service does not give it."""
        ...

    def venue_of(self, level_id: str) -> str:
        """Id of the venue that a level is of."""
        ...

    def open_session(self, prior: Prior, venue_id: str, *, method: str, parameters: Mapping[str, object]) -> str:
        """Open a session on ``prior.level_id``, or anywhere in the venue if the prior names no level.

        An empty ``method`` is the service's default.
        """
        ...

    def send_segment(self, session_id: str, seq: int, segment: Segment) -> Sequence[Fix]:
        """Send one segment and wait for its fixes (their ``level_id`` is the service's)."""
        ...

    def close_session(self, session_id: str) -> None:
        """Close the session."""
        ...

    def locate(
        self, prior: Prior, venue_id: str, segment: Segment, *, method: str, parameters: Mapping[str, object]
    ) -> Sequence[Fix]:
        """Locate a segment at once; place and method as in :meth:`open_session`."""
        ...


@dataclass(frozen=True, slots=True)
class HttpDriver:
    """Replays trips as sessions of a running service."""

    transport: Transport
    method: str
    parameters: Mapping[str, object]

    def replay(self, trip: Trip) -> Replay:
        """Send all segments of the trip in order; a failed segment is noted and the session goes on."""
        fixes: list[Fix] = []
        times: list[float] = []
        failures: list[str] = []
        session = self.transport.open_session(trip.prior, trip.venue_id, method=self.method, parameters=self.parameters)
        seq = 0
        for number, segment in enumerate(trip.segments):
            began = time.perf_counter()
            try:
                new = self.transport.send_segment(session, seq, segment)
            except TransportError as error:
                failures.append(f"segment {number}: {error}")
                seq += int(error.accepted)
                continue
            times.append(time.perf_counter() - began)
            fixes.extend(new)
            seq += 1
        self.transport.close_session(session)
        return Replay(tuple(fixes), tuple(times), tuple(failures))
