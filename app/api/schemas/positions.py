"""Positions of a session."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any, Literal

from pydantic import Field

from app.api.schemas.base import Out, PageOut, example
from app.api.schemas.fixes import FIXES_EXAMPLE, POSITION_EXAMPLE, FixesOut, fix_columns
from app.services.records import Position

GEO_JSON_EXAMPLE: dict[str, Any] = {
    "type": "FeatureCollection",
    "features": [
        {
            "type": "Feature",
            "id": 0,
            "geometry": {"type": "Point", "coordinates": [11.56925814, 48.15073659]},
            "properties": {
                "seq": 0,
                **{name: POSITION_EXAMPLE[name] for name in POSITION_EXAMPLE if not name.startswith("cov")},
            },
        }
    ],
    "next_cursor": None,
}


class PositionPage(PageOut):
    """Fixes of a session, oldest segment first, in columns; `seq` is the segment that told each, `number` counts."""

    model_config = example({"number": [0], "seq": [0], "fixes": FIXES_EXAMPLE, "next_cursor": None})

    number: list[int]
    seq: list[int]
    fixes: FixesOut


class PointOut(Out):
    """A place in WGS 84."""

    type: Literal["Point"]
    coordinates: Annotated[list[float], Field(min_length=2, max_length=2, description="Longitude, latitude.")]


class FeatureOut(Out):
    """One fix; level metres and everything else are in the properties."""

    type: Literal["Feature"]
    id: int
    geometry: PointOut
    properties: dict[str, Any]


class PositionCollection(PageOut):
    """Fixes as GeoJSON."""

    model_config = example(GEO_JSON_EXAMPLE)

    type: Literal["FeatureCollection"]
    features: list[FeatureOut]


def position_page(positions: Sequence[Position], next_cursor: str | None) -> dict[str, Any]:
    """Return positions as plain values, the shape of PositionPage."""
    return {
        "number": [position.number for position in positions],
        "seq": [position.seq for position in positions],
        "fixes": fix_columns([position.fix for position in positions]),
        "next_cursor": next_cursor,
    }
