"""Tracks as OGC Moving Features JSON (19-045r3), encoding MF-JSON Trajectory.

A trajectory is a GeoJSON feature with a LineString and one time a position in ``properties.datetimes``, strictly
rising. A session's track is a collection of them: one a stretch, for between stretches nothing is claimed.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

from app.engine.geodesy import TangentPlane
from app.exchange.tracks.document import (
    Stretch,
    TrackDocument,
    TrackPoint,
    dumped,
    iso_time,
    plane_of,
    spread_of,
    stretches,
)
from app.exchange.tracks.geojson import line_feature


def write_mf_json(document: TrackDocument, points: Iterable[TrackPoint]) -> Iterator[bytes]:
    """A FeatureCollection of trajectories, piece by piece. A stretch of a single fix is no line and is left out."""
    plane = plane_of(document)
    yield b'{"type":"FeatureCollection","properties":' + dumped(document.words()) + b',"features":['
    number = 0
    for stretch in stretches(points):
        if len(stretch.points) > 1:
            number += 1
            yield (b",\n" if number > 1 else b"\n") + dumped(_trajectory(document, stretch, plane, number))
    yield b"\n]}\n"


def _trajectory(document: TrackDocument, stretch: Stretch, plane: TangentPlane, number: int) -> dict[str, Any]:
    feature = line_feature(document, stretch, plane)
    spreads = [spread_of(point.fix) for point in stretch.points]
    properties = {name: value for name, value in feature["properties"].items() if name != "part"}
    return {
        "type": "Feature",
        "id": f"{document.session_id}/{number}",
        "geometry": feature["geometry"],
        "properties": {
            **properties,
            "datetimes": [iso_time(point.fix.t) for point in stretch.points],
            "sd_major_m": [round(spread.major_m, 3) for spread in spreads],
            "sd_minor_m": [round(spread.minor_m, 3) for spread in spreads],
            "sd_azimuth_deg": [round(spread.azimuth_deg(plane), 1) % 180.0 for spread in spreads],
        },
    }
