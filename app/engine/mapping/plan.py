"""Floor plans: where people can walk.

A plan is the outline of a floor and the units on it (shops, rooms, shafts, voids). Units count as obstacles unless
survey walks went through them: what was walked can be walked, whatever the plan calls it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.ndimage import distance_transform_edt

from app.engine.errors import InputError
from app.engine.types import BoolArray, Float64Array

Ring = Float64Array
"""Closed or open ring, shape (n, 2), m, level frame."""
_FINE_M = 0.25
_WALKED_DEPTH_M = 1.0
_WALKED_SHARE = 0.005


@dataclass(frozen=True, slots=True)
class Polygon:
    """Outer ring and holes, filled by the even-odd rule."""

    rings: tuple[Ring, ...]


@dataclass(frozen=True, slots=True)
class FloorPlan:
    """Outline of the floor (may be several parts, or none: unlimited) and the units on it."""

    outline: tuple[Polygon, ...]
    units: tuple[Polygon, ...]

    @property
    def extent(self) -> tuple[float, float, float, float] | None:
        """``(x_min, y_min, x_max, y_max)`` of the outline, m; None without one."""
        if not self.outline:
            return None
        points = np.concatenate([ring for polygon in self.outline for ring in polygon.rings])
        lo, hi = points.min(axis=0), points.max(axis=0)
        return float(lo[0]), float(lo[1]), float(hi[0]), float(hi[1])

    @classmethod
    def from_geojson(cls, plan: Mapping[str, Any]) -> FloorPlan:
        """Plan from a GeoJSON FeatureCollection in level metres.

        A polygon feature with ``"role": "floor"`` among its properties is outline, any other polygon a unit. When no
        feature has a role, the first polygon feature is the outline, as is common in exported plans.

        Raises
        ------
        InputError
            Not a FeatureCollection, or coordinates that are no rings of finite numbers.
        """
        features = plan.get("features")
        if plan.get("type") != "FeatureCollection" or not isinstance(features, list):
            raise InputError("plan", "must be a GeoJSON FeatureCollection")
        shapes = [(_role(f), _polygons(f, i)) for i, f in enumerate(features)]
        shapes = [(role, polygons) for role, polygons in shapes if polygons]
        if shapes and all(role is None for role, _ in shapes):
            shapes[0] = ("floor", shapes[0][1])
        return cls(
            outline=tuple(p for role, polygons in shapes if role == "floor" for p in polygons),
            units=tuple(p for role, polygons in shapes if role != "floor" for p in polygons),
        )


def _role(feature: Mapping[str, Any]) -> str | None:
    properties = feature.get("properties") if isinstance(feature, Mapping) else None
    role = properties.get("role") if isinstance(properties, Mapping) else None
    return role if isinstance(role, str) else None


def _polygons(feature: Mapping[str, Any], index: int) -> tuple[Polygon, ...]:
    """Polygons of a feature; none for points and lines."""
    geometry = feature.get("geometry") if isinstance(feature, Mapping) else None
    if not isinstance(geometry, Mapping) or geometry.get("type") not in ("Polygon", "MultiPolygon"):
        return ()
    parts = geometry.get("coordinates")
    parts = [parts] if geometry["type"] == "Polygon" else parts
    try:
        polygons = tuple(Polygon(tuple(_ring(ring) for ring in part)) for part in parts or ())
    except (TypeError, ValueError, IndexError) as error:
        raise InputError(
            f"plan.features[{index}].geometry.coordinates", f"are not rings of numbers: {error}"
        ) from error
    return tuple(p for p in polygons if p.rings)


def _ring(ring: Any) -> Ring:
    points = np.array([[point[0], point[1]] for point in ring], dtype=np.float64)
    if points.ndim != 2 or len(points) < 3 or not np.isfinite(points).all():
        raise ValueError("a ring needs at least three finite points")
    return points


def obstacle_depth(plan: FloorPlan, walked: Float64Array, x: Float64Array, y: Float64Array) -> Float64Array:
    """How deep each node lies in obstacles or outside the floor, m; 0 where people can walk.

    Parameters
    ----------
    plan : FloorPlan
    walked : array, shape (n, 2), m
        Survey positions.
    x, y : arrays, m
        Node coordinates, evenly spaced.

    Returns
    -------
    array, shape (len(y), len(x)), m
    """
    fine_x = np.arange(x[0] - 2.0, x[-1] + 2.0 + _FINE_M, _FINE_M)
    fine_y = np.arange(y[0] - 2.0, y[-1] + 2.0 + _FINE_M, _FINE_M)
    shape = (len(fine_y), len(fine_x))
    at = _cells(walked, fine_x, fine_y)
    floor = np.zeros(shape, dtype=bool) if plan.outline else np.ones(shape, dtype=bool)
    for polygon in plan.outline:
        floor |= fill(polygon, fine_x, fine_y)
    blocked = ~floor
    for polygon in plan.units:
        unit = fill(polygon, fine_x, fine_y)
        if not _was_walked(unit, at):
            blocked |= unit
    depth = distance_transform_edt(blocked) * _FINE_M
    xx, yy = np.meshgrid(x, y)
    rows, columns = _cells(np.stack([xx.ravel(), yy.ravel()], axis=1), fine_x, fine_y)
    result: Float64Array = depth[rows, columns].reshape(xx.shape)
    return result


def fill(polygon: Polygon, x: Float64Array, y: Float64Array) -> BoolArray:
    """Cells whose centre lies inside, even-odd rule; shape (len(y), len(x))."""
    inside = np.zeros((len(y), len(x)), dtype=bool)
    starts = np.concatenate(polygon.rings)
    ends = np.concatenate([np.roll(ring, -1, axis=0) for ring in polygon.rings])
    rows = np.flatnonzero((y >= starts[:, 1].min()) & (y <= starts[:, 1].max()))
    for row in rows:
        crossing = (starts[:, 1] <= y[row]) != (ends[:, 1] <= y[row])
        a, b = starts[crossing], ends[crossing]
        edges = np.sort(a[:, 0] + (y[row] - a[:, 1]) / (b[:, 1] - a[:, 1]) * (b[:, 0] - a[:, 0]))
        inside[row] = np.searchsorted(edges, x) % 2 == 1
    return inside


def _was_walked(unit: BoolArray, at: tuple[Sequence[int], Sequence[int]]) -> bool:
    """Whether more than a stray share of the walked positions lie deep inside."""
    if not unit[at].any():
        return False
    deep = distance_transform_edt(unit)[at] * _FINE_M > _WALKED_DEPTH_M
    return bool(deep.sum() > max(3, _WALKED_SHARE * unit[at].sum()))


def _cells(xy: Float64Array, x: Float64Array, y: Float64Array) -> tuple[Sequence[int], Sequence[int]]:
    columns = np.clip(np.rint((xy[:, 0] - x[0]) / _FINE_M).astype(np.int64), 0, len(x) - 1)
    rows = np.clip(np.rint((xy[:, 1] - y[0]) / _FINE_M).astype(np.int64), 0, len(y) - 1)
    return rows, columns
