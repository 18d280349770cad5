"""GeoJSON (RFC 7946): positions as features in WGS 84, and a check of plans."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any

from fastapi import Request

from app.api.schemas.fixes import ellipse95, heading_deg, hypothesis_object, t_ms
from app.engine.geodesy import TangentPlane
from app.services.records import Anchor, Position

GEO_JSON = "application/geo+json"


def wants_geo_json(request: Request) -> bool:
    """Whether GeoJSON is preferred: named, and not behind plain JSON."""
    ranks: dict[str, float] = {}
    for item in request.headers.get("accept", "").split(","):
        name, _, parameters = item.partition(";")
        key, _, value = parameters.strip().partition("=")
        weighted = key.strip() == "q" and value.strip().replace(".", "", 1).isdigit()
        ranks[name.strip().lower()] = float(value) if weighted else 1.0
    geo = ranks.get(GEO_JSON, 0.0)
    return geo > 0 and geo >= ranks.get("application/json", 0.0)


def feature_collection(positions: Sequence[Position], anchor: Anchor, next_cursor: str | None) -> dict[str, Any]:
    """Positions as points in WGS 84, with level metres and everything else as properties."""
    plane = anchor.plane()
    features = [_feature(position, plane) for position in positions]
    return {"type": "FeatureCollection", "features": features, "next_cursor": next_cursor}


def _feature(position: Position, plane: TangentPlane) -> dict[str, Any]:
    fix = position.fix
    longitude, latitude = plane.to_wgs84(fix.x, fix.y)
    return {
        "type": "Feature",
        "id": position.number,
        # 8 decimals of a degree are about a millimetre
        "geometry": {"type": "Point", "coordinates": [round(longitude, 8), round(latitude, 8)]},
        "properties": {
            "seq": position.seq,
            "t_ms": t_ms(fix),
            "kind": fix.kind.value,
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
