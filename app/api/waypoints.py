"""Checks of a survey walk's waypoints. Each finding names field and remedy."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from app.api.errors import RejectedError
from app.api.plausibility import column_finite, length_error, not_increasing, outside_time, raise_any
from app.api.schemas.samples import WaypointsIn
from app.api.validation import FieldError
from app.engine.types import Float64Array

WAYPOINT_SLACK_S = 10.0
WAYPOINT_SLACK_M = 50.0
STILL_S, STILL_M = 20.0, 1.0
"""A walk whose waypoints span this time and not this path length is none."""
Extent = tuple[float, float, float, float]


def check_waypoints(waypoints: WaypointsIn, t_ms: Float64Array, extent: Extent) -> None:
    """Raise RejectedError for waypoints that do not belong to these samples or this level."""
    n = len(waypoints.t_ms)
    if n < 2:
        raise RejectedError([FieldError("waypoints.t_ms", f"has {n} of at least 2 waypoints", "label two places")])
    raise_any(
        length_error(f"waypoints.{name}", len(column), "waypoints.t_ms", n)
        for name, column in (("x", waypoints.x), ("y", waypoints.y))
        if len(column) != n
    )
    for name in ("t_ms", "x", "y"):
        raise_any(column_finite(f"waypoints.{name}", getattr(waypoints, name)))
    raise_any(not_increasing("waypoints.t_ms", waypoints.t_ms))
    remedy = "give waypoints of this walk, on the same clock as the samples"
    raise_any(outside_time("waypoints.t_ms", "waypoint", waypoints.t_ms, t_ms, WAYPOINT_SLACK_S, remedy))
    x_min, y_min, x_max, y_max = extent
    raise_any(_outside("waypoints.x", waypoints.x, x_min, x_max))
    raise_any(_outside("waypoints.y", waypoints.y, y_min, y_max))
    raise_any(_still(waypoints))


def _still(waypoints: WaypointsIn) -> Iterator[FieldError]:
    span_s = (waypoints.t_ms[-1] - waypoints.t_ms[0]) / 1000
    length_m = float(np.hypot(np.diff(waypoints.x), np.diff(waypoints.y)).sum())
    if span_s >= STILL_S and length_m < STILL_M:
        yield FieldError(
            "waypoints.x",
            f"all waypoints lie at one place: {length_m:.2f} m in {span_s:.0f} s",
            "label the places the walk went through; a recording at one place makes no map",
        )


def _outside(name: str, values: Float64Array, low: float, high: float) -> Iterator[FieldError]:
    outside = (values < low - WAYPOINT_SLACK_M) | (values > high + WAYPOINT_SLACK_M)
    if outside.any():
        i = int(outside.argmax())
        yield FieldError(
            name,
            f"waypoint {i} lies at {values[i]:.1f} m, more than {WAYPOINT_SLACK_M:g} m outside the level "
            f"({low:g} to {high:g} m)",
            "give metres in the level's frame, or correct the level's extent",
        )
