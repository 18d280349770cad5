"""Dead reckoning: steps and gyroscope alone. The baseline that the map must beat."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace

import numpy as np

from app.engine.errors import StateError
from app.engine.inertial import PedestrianState, StepEvents, advance, gap_before, settled_until
from app.engine.inertial.stride import BOUNCE, SPREAD
from app.engine.localization import codec
from app.engine.localization.compass import start_heading
from app.engine.localization.initial import WALKING_M_S
from app.engine.types import (
    Answer,
    DeviceCalibration,
    Fix,
    GridMap,
    MapSource,
    Prior,
    Segment,
    Status,
    TrackerState,
)

_HEADING_SD = 0.25
"""rad: compass start against the level's mean field, and how the device was held."""
_UNKNOWN_SD_M = 50.0


@dataclass(frozen=True, slots=True)
class DeadReckoningParameters:
    """What a caller may choose.

    Attributes
    ----------
    stride_constant : float
        Constant of the stride model, m^(3/4) (see :func:`app.engine.inertial.stride.stride_length`).
    """

    stride_constant: float = BOUNCE


@dataclass(slots=True)
class _Track:
    """A session under way: ``offset`` takes the free-azimuth heading to the level frame."""

    pedestrian: PedestrianState
    offset: float
    x: float
    y: float
    heading: float
    walked_m: float = 0.0
    unseen_m: float = 0.0
    """Metres the walker may have gone while nobody watched."""


class DeadReckoningTracker:
    """Position from the prior, heading from the first field reading against the level's mean field, then steps.

    Strides are the model's, times what the prior knows of the carrier's.
    """

    method = "dead_reckoning"

    def __init__(self, parameters: DeadReckoningParameters | None = None) -> None:
        self.parameters = parameters or DeadReckoningParameters()

    def start(self, prior: Prior, *, seed: int) -> TrackerState:  # noqa: ARG002 - the contract; nothing is drawn
        """State before the first segment."""
        return TrackerState(self.method, codec.pack({"prior": codec.prior_values(prior), "track": None}))

    def step(
        self, state: TrackerState, segment: Segment, map_source: MapSource
    ) -> tuple[TrackerState, tuple[Fix, ...]]:
        """Advance by one segment: a fix per confirmed step, and one where steps are settled."""
        if state.method != self.method:
            raise StateError(f"state belongs to method {state.method!r}, not {self.method!r}")
        values = codec.unpack(state.payload)
        prior, before = codec.prior_from(values["prior"]), values["track"]
        known = None if before is None else codec.pedestrian_state(before.pop("pedestrian"))
        gap = 0.0 if known is None else gap_before(known, segment.samples)
        pedestrian, events = advance(known, segment.samples, speed=segment.speed, steps=segment.steps)
        level_id = map_source.level_ids()[0] if prior.level_id is None else prior.level_id
        track = _begin(prior, pedestrian, events, map_source.grid_map(level_id))
        if before is not None:
            old = _Track(pedestrian=pedestrian, **before)
            track = _resume(old, track, gap) if gap > 0.0 else old
        fixes = [self._walk(track, prior, level_id, events, i) for i in range(len(events))]
        last_t = float(segment.samples.t[-1])
        fixes.append(_fix(track, prior, level_id, settled_until(segment.samples.t)))
        after = {**asdict(track), "pedestrian": codec.pedestrian_values(pedestrian)}
        return TrackerState(
            self.method, codec.pack({"prior": codec.prior_values(prior), "track": after}), last_t
        ), tuple(fixes)

    def answer(self, state: TrackerState, segment: Segment, map_source: MapSource) -> Answer:
        """Advance like :meth:`step`: without the map nothing that comes later says anything of what was before."""
        return Answer(*self.step(state, segment, map_source))

    def learned(self, state: TrackerState) -> DeviceCalibration | None:  # noqa: ARG002 - the contract
        """Nothing: without the map neither offset nor stride can be told."""
        return None

    def _walk(self, track: _Track, prior: Prior, level_id: str, events: StepEvents, i: int) -> Fix:
        known = 1.0 if prior.calibration is None else prior.calibration.stride_scale
        scale = 1.0 if events.measured[i] else known * self.parameters.stride_constant / BOUNCE
        stride = scale * float(events.stride[i])
        track.heading = float(events.motion_heading[i]) + track.offset
        track.x += stride * float(np.cos(track.heading))
        track.y += stride * float(np.sin(track.heading))
        track.walked_m += stride
        return _fix(track, prior, level_id, float(events.t[i]))


def _begin(prior: Prior, pedestrian: PedestrianState, events: StepEvents, grid_map: GridMap) -> _Track:
    heading, _, free = start_heading(prior, pedestrian, events, grid_map)
    return _Track(pedestrian, heading - free, prior.x or 0.0, prior.y or 0.0, heading)


def _resume(old: _Track, fresh: _Track, gap_s: float) -> _Track:
    """Old place, fresh heading, and the distance that may lie between."""
    return replace(fresh, x=old.x, y=old.y, walked_m=old.walked_m, unseen_m=old.unseen_m + WALKING_M_S * gap_s)


def _fix(track: _Track, prior: Prior, level_id: str, t: float) -> Fix:
    """Fix with a circular covariance: the start's, and heading and stride errors over the net displacement."""
    known = prior.x is not None and prior.y is not None
    start = prior.radius_m / 2.0 if known else _UNKNOWN_SD_M
    away = np.hypot(track.x - (prior.x or 0.0), track.y - (prior.y or 0.0))
    drift = np.hypot(_HEADING_SD, SPREAD) * away / np.sqrt(2.0) + 0.02 * track.walked_m
    variance = float(start**2 + drift**2 + track.unseen_m**2 / 4.0)
    return Fix(
        t=t,
        level_id=level_id,
        x=track.x,
        y=track.y,
        cov_xx=variance,
        cov_xy=0.0,
        cov_yy=variance,
        heading=track.heading,
        status=Status.OFF_MAP if known else Status.INSUFFICIENT,
        quality=float(1.0 / (1.0 + variance / 9.0)) if known else 0.0,
        sure=False,
    )
