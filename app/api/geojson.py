"""GeoJSON (RFC 7946): level metres to WGS 84 through a venue's anchor, positions as features, and a check of plans."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from app.api.schemas.fixes import ellipse95, heading_deg, hypothesis_object, t_ms
from app.services.records import Anchor, Position

GEO_JSON = "application/geo+json"

# WGS 84 (NGA.STND.0036, 2014): semi-major axis in m, flattening; the rest follows.
_A = 6378137.0
_F = 1 / 298.257223563
_B = _A * (1 - _F)
_E2 = _F * (2 - _F)
_SECOND_E2 = _E2 / (1 - _E2)


@dataclass(frozen=True, slots=True)
class LevelToWgs84:
    """Takes plan metres to longitude and latitude in degrees.

    The level is the tangent plane at the anchor. A point goes through earth-centred coordinates, so the only
    approximation is Bowring's closed form back to latitude (Survey Review 23 (181), 1976), exact to nanometres here.
    """

    anchor: Anchor

    def __call__(self, x: float, y: float) -> tuple[float, float]:
        """Longitude and latitude of a point of the level."""
        bearing = math.radians(self.anchor.bearing_deg)
        east = x * math.cos(bearing) + y * math.sin(bearing)
        north = y * math.cos(bearing) - x * math.sin(bearing)
        return _to_degrees(*self._earth_centred(east, north))

    def _earth_centred(self, east: float, north: float) -> tuple[float, float, float]:
        """Equatorial coordinates along and across the anchor's meridian, and the polar one, turned to Greenwich."""
        latitude, longitude = math.radians(self.anchor.latitude_deg), math.radians(self.anchor.longitude_deg)
        sin_lat, cos_lat = math.sin(latitude), math.cos(latitude)
        normal = _A / math.sqrt(1 - _E2 * sin_lat**2)
        along = (normal + self.anchor.height_m) * cos_lat - north * sin_lat
        polar = (normal * (1 - _E2) + self.anchor.height_m) * sin_lat + north * cos_lat
        return (
            along * math.cos(longitude) - east * math.sin(longitude),
            along * math.sin(longitude) + east * math.cos(longitude),
            polar,
        )


def _to_degrees(x: float, y: float, z: float) -> tuple[float, float]:
    radius = math.hypot(x, y)
    parametric = math.atan2(z * _A, radius * _B)
    latitude = math.atan2(
        z + _SECOND_E2 * _B * math.sin(parametric) ** 3, radius - _E2 * _A * math.cos(parametric) ** 3
    )
    return math.degrees(math.atan2(y, x)), math.degrees(latitude)


def feature_collection(positions: Sequence[Position], anchor: Anchor, next_cursor: str | None) -> dict[str, Any]:
    """Positions as points in WGS 84, with level metres and everything else as properties."""
    to_wgs84 = LevelToWgs84(anchor)
    features = [_feature(position, to_wgs84) for position in positions]
    return {"type": "FeatureCollection", "features": features, "next_cursor": next_cursor}


def _feature(position: Position, to_wgs84: LevelToWgs84) -> dict[str, Any]:
    fix = position.fix
    longitude, latitude = to_wgs84(fix.x, fix.y)
    return {
        "type": "Feature",
        "id": position.number,
        # 8 decimals of a degree are about a millimetre
        "geometry": {"type": "Point", "coordinates": [round(longitude, 8), round(latitude, 8)]},
        "properties": {
            "seq": position.seq,
            "t_ms": t_ms(fix),
            "level_id": fix.level_id,
            "x": fix.x,
            "y": fix.y,
            "heading_deg": heading_deg(fix),
            "status": fix.status.value,
            "quality": fix.quality,
            "sure": fix.sure,
            "walk_on_m": fix.walk_on_m,
            "hypotheses": [hypothesis_object(h) for h in fix.hypotheses],
            "ellipse95": ellipse95(fix),
        },
    }


_GEOMETRIES = frozenset(
    {"Point", "MultiPoint", "LineString", "MultiLineString", "Polygon", "MultiPolygon", "GeometryCollection"}
)


def plan_fault(value: object) -> tuple[str, str] | None:
    """Say what is wrong with a vector plan (field, message); None if it is a feature collection in metres."""
    if not isinstance(value, dict) or value.get("type") != "FeatureCollection":
        return "type", "is not FeatureCollection"
    features = value.get("features")
    if not isinstance(features, list):
        return "features", "is not an array"
    for index, feature in enumerate(features):
        path = f"features.{index}"
        if not isinstance(feature, dict) or feature.get("type") != "Feature":
            return path, "is not a Feature"
        fault = _geometry_fault(feature.get("geometry"), f"{path}.geometry")
        if fault is not None:
            return fault
    return None


def _geometry_fault(geometry: object, path: str) -> tuple[str, str] | None:
    # A stack, not recursion: collections may be nested as deeply as JSON allows.
    stack = [] if geometry is None else [(geometry, path)]
    while stack:
        item, where = stack.pop()
        if not isinstance(item, dict) or item.get("type") not in _GEOMETRIES:
            return where, "is not a geometry"
        if item["type"] == "GeometryCollection":
            parts = item.get("geometries")
            if not isinstance(parts, list):
                return f"{where}.geometries", "is not an array"
            stack.extend((part, f"{where}.geometries.{i}") for i, part in enumerate(parts))
        elif not isinstance(item.get("coordinates"), list) or not all(
            map(_is_coordinate, _leaves(item["coordinates"]))
        ):
            return f"{where}.coordinates", "holds something that is not a finite number of metres"
    return None


def _leaves(value: list[Any]) -> Iterable[object]:
    stack: list[Any] = [value]
    while stack:
        item = stack.pop()
        if isinstance(item, list):
            stack.extend(item)
        else:
            yield item


def _is_coordinate(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value) and abs(value) < 1e7
