"""Tracks as GeoJSON (RFC 7946): all fixes as points, and lines through the stretches that claim a position."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator
from typing import Any

from app.engine.geodesy import TangentPlane
from app.exchange.tracks.document import (
    Stretch,
    TrackDocument,
    TrackPoint,
    degrees_of,
    dumped,
    iso_time,
    plane_of,
    spread_of,
    stretches,
)


def write_geojson(document: TrackDocument, points: Iterable[TrackPoint]) -> Iterator[bytes]:
    """A FeatureCollection, piece by piece: each stretch of the line behind its own points.

    Lines are features with ``"part": "line"``, points with ``"part": "fix"``.
    """
    plane = plane_of(document)
    yield b'{"type":"FeatureCollection","properties":' + dumped(document.words()) + b',"features":['
    separator = b"\n"
    for feature in _features(document, points, plane):
        yield separator + dumped(feature)
        separator = b",\n"
    yield b"\n]}\n"


def _features(document: TrackDocument, points: Iterable[TrackPoint], plane: TangentPlane) -> Iterator[dict[str, Any]]:
    """Points as they come, and a line when the stretch it runs through has ended."""
    told: list[TrackPoint] = []

    def seen() -> Iterator[TrackPoint]:
        for point in points:
            told.append(point)
            yield point

    for stretch in itertools.chain(stretches(seen()), [None]):
        # the point that ended the stretch is among those told: it comes before the line, which names its own ends
        yield from (_fix(point, plane) for point in told)
        told.clear()
        if stretch is not None and len(stretch.points) > 1:
            yield line_feature(document, stretch, plane)


def line_feature(document: TrackDocument, stretch: Stretch, plane: TangentPlane) -> dict[str, Any]:
    """A stretch as a line."""
    first, last = stretch.points[0], stretch.points[-1]
    return {
        "type": "Feature",
        "geometry": {"type": "LineString", "coordinates": [degrees_of(one.fix, plane) for one in stretch.points]},
        "properties": {
            "part": "line",
            "session_id": document.session_id,
            "kind": document.kind.value,
            "level_id": stretch.level_id,
            "level": document.level_name(stretch.level_id),
            "sure": stretch.sure,
            "start": iso_time(first.fix.t),
            "end": iso_time(last.fix.t),
            "first": first.number,
            "last": last.number,
        },
    }


def _fix(point: TrackPoint, plane: TangentPlane) -> dict[str, Any]:
    fix, spread = point.fix, spread_of(point.fix)
    return {
        "type": "Feature",
        "id": point.number,
        "geometry": {"type": "Point", "coordinates": degrees_of(fix, plane)},
        "properties": {
            "part": "fix",
            "seq": point.seq,
            "time": iso_time(fix.t),
            "kind": fix.kind.value,
            "level_id": fix.level_id,
            "x": round(fix.x, 3),
            "y": round(fix.y, 3),
            "sd_major_m": round(spread.major_m, 3),
            "sd_minor_m": round(spread.minor_m, 3),
            "sd_azimuth_deg": round(spread.azimuth_deg(plane), 1) % 180.0,
            "status": fix.status.value,
            "sure": fix.sure,
            "quality": round(fix.quality, 4),
        },
    }
