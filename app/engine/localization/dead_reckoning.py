"""Dead reckoning: steps and gyroscope alone. The baseline that the map must beat."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from app.engine.errors import StateError
from app.engine.inertial import PedestrianState, StepEvents, advance
from app.engine.inertial.stride import SPREAD, WEINBERG, weinberg
from app.engine.localization import codec
from app.engine.types import FeatureSet, Fix, Float64Array, GridMap, MapSource, Prior, Segment, Status, TrackerState

_HEADING_SD = 0.25
"""rad: compass start against the level's mean field, and how the device was held."""
_UNKNOWN_SD_M = 50.0


@dataclass(frozen=True, slots=True)
class DeadReckoningParameters:
    """What a caller may choose.

    Attributes
    ----------
    stride_constant : float
        Weinberg constant, m / (m/s^2)^(1/4).
    """

    stride_constant: float = WEINBERG


@dataclass(slots=True)
class _State:
    prior: Prior
    pedestrian: PedestrianState | None = None
    offset: float | None = None
    x: float = 0.0
    y: float = 0.0
    heading: float = 0.0
    walked_m: float = 0.0

    def values(self) -> dict[str, Any]:
        return {
            "prior": codec.prior_values(self.prior), "pedestrian": codec.pedestrian_values(self.pedestrian),
            "offset": self.offset, "x": self.x, "y": self.y, "heading": self.heading, "walked_m": self.walked_m,
        }  # fmt: skip

    @classmethod
    def of(cls, values: dict[str, Any]) -> _State:
        return cls(
            Prior(**values["prior"]), codec.pedestrian_state(values["pedestrian"]), values["offset"],
            values["x"], values["y"], values["heading"], values["walked_m"],
        )  # fmt: skip


class DeadReckoningTracker:
    """Position from the prior, heading from the first field reading against the level's mean field, then steps."""

    method = "dead_reckoning"

    def __init__(self, parameters: DeadReckoningParameters | None = None) -> None:
        self.parameters = parameters or DeadReckoningParameters()

    def start(self, prior: Prior, *, seed: int) -> TrackerState:  # noqa: ARG002 - the contract; nothing is drawn
        """State before the first segment."""
        return TrackerState(self.method, codec.pack(_State(prior, x=prior.x or 0.0, y=prior.y or 0.0).values()))

    def step(
        self, state: TrackerState, segment: Segment, map_source: MapSource
    ) -> tuple[TrackerState, tuple[Fix, ...]]:
        """Advance by one segment: a fix per confirmed step, and one at the segment's end."""
        if state.method != self.method:
            raise StateError(f"state belongs to method {state.method!r}, not {self.method!r}")
        s = _State.of(codec.unpack(state.payload))
        s.pedestrian, events = advance(s.pedestrian, segment.samples)
        if s.offset is None:
            s.offset = self._compass(s, events, map_source.grid_map(s.prior.level_id))
        fixes = [self._walk(s, events, i, s.offset) for i in range(len(events))]
        last_t = float(segment.samples.t[-1])
        fixes.append(_fix(s, last_t))
        return TrackerState(self.method, codec.pack(s.values()), last_t), tuple(fixes)

    def _compass(self, s: _State, events: StepEvents, grid_map: GridMap) -> float:
        """Level heading minus free-azimuth heading."""
        assert s.pedestrian is not None  # set by the caller
        tail = s.pedestrian.tail
        heading = float(events.heading[0]) if len(events) else float(tail.heading[-1])
        s.heading = heading
        if s.prior.heading is not None:
            return s.prior.heading - heading
        if grid_map.features is not FeatureSet.VECTOR:
            return -heading
        mag = events.mag[0] if len(events) else tail.mag[-10:].mean(axis=0)
        mean = _mean_field(grid_map)
        return float(np.arctan2(mean[1], mean[0]) - np.arctan2(mag[1], mag[0])) - heading

    def _walk(self, s: _State, events: StepEvents, i: int, offset: float) -> Fix:
        stride = float(weinberg(events.swing[i : i + 1], self.parameters.stride_constant)[0])
        s.heading = float(events.motion_heading[i])
        s.x += stride * float(np.cos(s.heading + offset))
        s.y += stride * float(np.sin(s.heading + offset))
        s.walked_m += stride
        return _fix(s, float(events.t[i]))


def _mean_field(grid_map: GridMap) -> Float64Array:
    mapped = grid_map.mapped
    nodes = grid_map.mean[:, mapped] if mapped.any() else grid_map.mean.reshape(len(grid_map.mean), -1)
    mean: Float64Array = nodes.mean(axis=1, dtype=np.float64)
    return mean


def _fix(s: _State, t: float) -> Fix:
    """Fix with a circular covariance: start, and heading and stride errors over the net displacement."""
    known = s.prior.x is not None and s.prior.y is not None
    start = s.prior.radius_m / 2.0 if known else _UNKNOWN_SD_M
    away = np.hypot(s.x - (s.prior.x or 0.0), s.y - (s.prior.y or 0.0))
    drift = np.hypot(_HEADING_SD, SPREAD) * away / np.sqrt(2.0) + 0.02 * s.walked_m
    variance = float(start**2 + drift**2)
    return Fix(
        t=t, level_id=s.prior.level_id, x=s.x, y=s.y, cov_xx=variance, cov_xy=0.0, cov_yy=variance,
        heading=float(s.heading + (s.offset or 0.0)),
        status=Status.OFF_MAP if known else Status.INSUFFICIENT,
        quality=float(1.0 / (1.0 + variance / 9.0)) if known else 0.0, sure=False,
    )  # fmt: skip
