"""Vector plans: GeoJSON in longitude and latitude to GeoJSON in level metres."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

GeoJson = dict[str, Any]
"""A GeoJSON object: coordinates nest to any depth, so no closer type helps."""

_KEPT_PROPERTIES = ("name", "category")
_MILLIMETRE = 3
_EDGE_M = 0.1


def plan_to_level_metres(plan: Mapping[str, Any], width_m: float, height_m: float) -> GeoJson:
    """Stretch a plan to its level.

    The bounding box of all coordinates *is* the plan rectangle: x east from its left edge, y north from its
    lower edge. (The sources use a shifted map datum, so only the shape is meaningful.)

    Returns a ``FeatureCollection`` whose features keep geometry, ``name`` and ``category`` and get a ``role``:
    ``floor`` for what spans the whole rectangle (the outline), ``unit`` for the rest. Coordinates are rounded to
    millimetres.

    Raises
    ------
    ValueError
        No coordinates, or a bounding box without area.
    """
    features = [feature for feature in plan.get("features", ()) if (feature.get("geometry") or {}).get("coordinates")]
    points = [point for feature in features for point in positions(feature["geometry"]["coordinates"])]
    if not points:
        raise ValueError("the plan holds no coordinates")
    x_min, x_max = min(p[0] for p in points), max(p[0] for p in points)
    y_min, y_max = min(p[1] for p in points), max(p[1] for p in points)
    if not (x_max > x_min and y_max > y_min):
        raise ValueError("the plan's bounding box has no area")
    x_scale, y_scale = width_m / (x_max - x_min), height_m / (y_max - y_min)

    def to_metres(position: list[float]) -> list[float]:
        return [
            round((position[0] - x_min) * x_scale, _MILLIMETRE),
            round((position[1] - y_min) * y_scale, _MILLIMETRE),
        ]

    size = (width_m, height_m)
    return {"type": "FeatureCollection", "features": [_feature(feature, to_metres, size) for feature in features]}


def positions(coordinates: Any) -> Iterator[list[float]]:
    """All positions in nested GeoJSON coordinates."""
    if coordinates and isinstance(coordinates[0], int | float):
        yield coordinates
        return
    for part in coordinates:
        yield from positions(part)


def rings(plan: Mapping[str, Any]) -> Iterator[list[list[float]]]:
    """All rings and lines of a plan, as lists of positions (for drawing)."""
    for feature in plan["features"]:
        yield from _lines(feature["geometry"]["coordinates"])


def _lines(coordinates: Any) -> Iterator[list[list[float]]]:
    if not coordinates or isinstance(coordinates[0], int | float):
        return
    if isinstance(coordinates[0][0], int | float):
        yield coordinates
        return
    for part in coordinates:
        yield from _lines(part)


def _feature(
    feature: Mapping[str, Any], to_metres: Callable[[list[float]], list[float]], size: tuple[float, float]
) -> GeoJson:
    properties = feature.get("properties") or {}
    geometry = feature["geometry"]
    coordinates = _map_positions(geometry["coordinates"], to_metres)
    role = "floor" if _spans(coordinates, size) else "unit"
    return {
        "type": "Feature",
        "properties": {name: properties[name] for name in _KEPT_PROPERTIES if properties.get(name)} | {"role": role},
        "geometry": {"type": geometry["type"], "coordinates": coordinates},
    }


def _spans(coordinates: Any, size: tuple[float, float]) -> bool:
    """Whether a shape reaches all four edges of the plan."""
    points = list(positions(coordinates))
    return all(
        min(p[axis] for p in points) <= _EDGE_M and max(p[axis] for p in points) >= size[axis] - _EDGE_M
        for axis in (0, 1)
    )


def _map_positions(coordinates: Any, convert: Callable[[list[float]], list[float]]) -> Any:
    if coordinates and isinstance(coordinates[0], int | float):
        return convert(coordinates)
    return [_map_positions(part, convert) for part in coordinates]
