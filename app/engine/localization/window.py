"""The last steps of a session as one question to a matcher."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from app.engine.inertial import StepEvents
from app.engine.inertial.stride import SPREAD
from app.engine.localization.profile import join, newest, no_steps, profile_from, profile_values
from app.engine.matching import MatchProblem, Profile, Region, RouteMap, Track, common_features, route_along
from app.engine.types import DeviceCalibration, FeatureSet, Float64Array, GridMap

STEPS = 60
"""Steps that a matcher looks back on: the shape of 40 m tells a place."""
SPACING_M = 0.25
"""Between points of the lines that sequences are compared with."""
_NOISE = 2.8
"""Of the map's repeatability: readings of one walk err together over metres, as the particle filter's fit shows."""
_OFFSET_UT = 5.5
"""Hard iron that the platform's calibration leaves, one standard deviation."""
_SHAPE = 0.04
"""Error of dead reckoning's shape, of the way: what turning and stretching the whole does not mend."""
_KNOWN_TURN = 0.1
_UNKNOWN_M = 1e4


@dataclass(frozen=True, slots=True)
class Window:
    """Newest steps of a session and where they have been told to be.

    Attributes
    ----------
    events : StepEvents
    x, y : array, shape (k,), m, level frame
        Where each step was told to be.
    x0, y0 : float, m
        Where the walker was before the first of them.
    variance : float, m^2
        Of that place, per axis.
    turn_sd : float, rad
        Of the heading of the whole.
    """

    events: StepEvents
    x: Float64Array
    y: Float64Array
    x0: float
    y0: float
    variance: float
    turn_sd: float

    @classmethod
    def start(cls, x: float, y: float, variance: float, turn_sd: float) -> Window:
        """No steps yet."""
        return cls(no_steps(), np.empty(0), np.empty(0), x, y, variance, turn_sd)

    @property
    def located(self) -> bool:
        """Whether anything is known of the place."""
        return self.variance < _UNKNOWN_M

    @property
    def here(self) -> tuple[float, float]:
        """Where the newest step was told to be, m."""
        return (float(self.x[-1]), float(self.y[-1])) if len(self.x) else (self.x0, self.y0)

    def walked(self, events: StepEvents, x: Float64Array, y: Float64Array) -> Window:
        """With further steps at these places; the oldest are forgotten."""
        both = join(self.events, events)
        x, y = np.concatenate([self.x, x]), np.concatenate([self.y, y])
        dropped = max(len(both) - STEPS, 0)
        if dropped == 0:
            return replace(self, events=both, x=x, y=y)
        gone = float(both.stride[:dropped].sum())
        return Window(
            events=newest(both, STEPS),
            x=x[dropped:],
            y=y[dropped:],
            x0=float(x[dropped - 1]),
            y0=float(y[dropped - 1]),
            variance=self.variance + 0.5 * (SPREAD * gone) ** 2 if self.located else self.variance,
            turn_sd=self.turn_sd,
        )

    def placed(self, x: Float64Array, y: Float64Array, x0: float, y0: float, variance: float) -> Window:
        """The same steps at other places, the first of which is known with this variance (m^2, per axis)."""
        return replace(self, x=x, y=y, x0=x0, y0=y0, variance=variance, turn_sd=_KNOWN_TURN)

    def values(self) -> dict[str, Any]:
        """As plain values."""
        return {
            "events": profile_values(self.events),
            "x": self.x,
            "y": self.y,
            "start": [self.x0, self.y0, self.variance, self.turn_sd],
        }

    @classmethod
    def of(cls, values: dict[str, Any]) -> Window:
        """Inverse of :meth:`values`."""
        return cls(profile_from(values["events"]), values["x"], values["y"], *values["start"])


def reckon(events: StepEvents, offset: float, scale: float, x: float, y: float) -> tuple[Float64Array, Float64Array]:
    """Places after each step from ``(x, y)`` on, m; ``offset`` (rad) takes free azimuth to the level frame."""
    heading = events.motion_heading + offset
    stride = np.where(events.measured, 1.0, scale) * events.stride
    return x + np.cumsum(stride * np.cos(heading)), y + np.cumsum(stride * np.sin(heading))


def problem_of(
    window: Window,
    grid_map: GridMap,
    offset: float,
    scale: float,
    *,
    calibration: DeviceCalibration | None,
    routes: tuple[RouteMap, ...],
    seed: int,
) -> MatchProblem:
    """The window's steps as a track from the place before them on, with their readings.

    Parameters
    ----------
    window : Window
        At least one step.
    grid_map : GridMap
    offset : float, rad
        Takes free azimuth to the level frame.
    scale : float
        Of modelled strides.
    calibration : DeviceCalibration or None
    routes : tuple of RouteMap
    seed : int
    """
    events = window.events
    x, y = reckon(events, offset, scale, window.x0, window.y0)
    way = np.cumsum(events.stride)
    variance = (_SHAPE * (way - way[0])) ** 2
    track = Track(events.t, x, y, events.motion_heading + offset, variance[:, None, None] * np.eye(2))
    mag, offset_sd = events.mag, _OFFSET_UT
    if calibration is not None:
        mag = mag - np.array(calibration.offset)
        offset_sd = min(offset_sd, float(np.sqrt(np.mean(np.square(calibration.offset_sd)))))
    angle = events.heading + offset
    c, s = np.cos(angle), np.sin(angle)
    vector = np.stack([c * mag[:, 0] - s * mag[:, 1], s * mag[:, 0] + c * mag[:, 1], mag[:, 2]], axis=1)
    noise_sd = np.full(3, _NOISE * float(np.sqrt(np.mean(np.square(grid_map.noise_sd)))))
    profile = Profile(FeatureSet.VECTOR, vector, noise_sd, offset_sd)
    profile = profile.as_features(common_features(FeatureSet.VECTOR, grid_map.features))
    region = None
    if window.located:
        cov = (window.variance + (SPREAD * float(events.stride[0])) ** 2) * np.eye(2)
        scale_sd = SPREAD if calibration is None else min(calibration.stride_scale_sd, SPREAD)
        region = Region(float(x[0]), float(y[0]), cov, window.turn_sd, scale_sd)
    return MatchProblem(profile, track, grid_map, region, routes, seed=seed)


def routes_of(grid_map: GridMap) -> tuple[RouteMap, ...]:
    """The survey's lines as maps of one dimension; empty for maps without."""
    if grid_map.routes is None:
        return ()
    found = (route_along(grid_map, line.astype(np.float64), SPACING_M) for line in grid_map.routes.lines())
    return tuple(route for route in found if route is not None)
