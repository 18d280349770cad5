"""The contract of trackers: prior, state, answer."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from app.engine.errors import InputError
from app.engine.types.devices import DeviceCalibration
from app.engine.types.fixes import Fix
from app.engine.types.maps import MapSource
from app.engine.types.recordings import Segment


@dataclass(frozen=True, slots=True)
class Prior:
    """What is known before the first segment.

    ``level_id`` None means any of the levels that the map source has.

    ``x`` and ``y`` are both given (a disc of ``radius_m``, uniform inside) or both None (anywhere on the
    level). ``heading`` is the direction of the device's y axis in the level frame, radians
    counter-clockwise from +x; None means unknown. ``calibration`` is what is known about the device.
    """

    level_id: str | None
    x: float | None = None
    y: float | None = None
    radius_m: float = 3.0
    heading: float | None = None
    heading_sd: float = 0.35
    calibration: DeviceCalibration | None = None

    def __post_init__(self) -> None:
        if (self.x is None) != (self.y is None):
            raise InputError("prior", "x and y must be given together or not at all")
        if self.level_id is None and self.x is not None:
            raise InputError("prior", "x and y mean nothing without a level")


@dataclass(frozen=True, slots=True)
class TrackerState:
    """State of a tracker between two segments: opaque bytes that carry their own version.

    ``last_t`` is the time of the newest sample seen (None before the first).
    """

    method: str
    payload: bytes
    last_t: float | None = None


@dataclass(frozen=True, slots=True)
class Answer:
    """What a tracker makes of a segment.

    Attributes
    ----------
    state : TrackerState
        After the segment.
    fixes : tuple of Fix
        ``filtered``, in time order: those of :meth:`Tracker.step`.
    lagged : tuple of Fix
        ``fixed_lag``, in time order, within a segment and from one to the next: earlier steps, each told once and at
        most, now that more is known of them. Empty for methods that look back on nothing.
    """

    state: TrackerState
    fixes: tuple[Fix, ...]
    lagged: tuple[Fix, ...] = ()


class Tracker(Protocol):
    """A recursive method: state and segment in, state and fixes out.

    A tracker holds parameters only. The same state and segment always give the same answer (the random
    generator is part of the state), so any worker may take the next segment and may take it again
    after a crash.
    """

    def start(self, prior: Prior, *, seed: int) -> TrackerState:
        """State before the first segment."""
        ...

    def step(
        self, state: TrackerState, segment: Segment, map_source: MapSource
    ) -> tuple[TrackerState, tuple[Fix, ...]]:
        """Advance by one segment: a fix per step confirmed, and one at the time up to which steps are settled.

        Fixes are in time order, within a segment and from one to the next. A step takes its peak and 0.3 s to be
        confirmed, so the last fix lies that much before the segment's end.
        """
        ...

    def answer(self, state: TrackerState, segment: Segment, map_source: MapSource) -> Answer:
        """Advance like :meth:`step`, to the same state and fixes, and also look back."""
        ...

    def learned(self, state: TrackerState) -> DeviceCalibration | None:
        """What the session so far teaches about the device; None while it is not to be relied on."""
        ...
