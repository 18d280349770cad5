"""What is looked for in lists of venues and levels: ``near`` with ``radius_m``, ``bbox``, ``q``."""

from __future__ import annotations

import math
from typing import Annotated

from fastapi import Depends, Query

from app.api.errors import RejectedError
from app.api.validation import LINE_PATTERN, FieldError
from app.engine.geodesy import GeoBox
from app.services.search import DEFAULT_RADIUS_M, MAX_RADIUS_M, Near, Search, query_words

_Near = Query(
    max_length=64,
    description="`latitude,longitude` in degrees, WGS 84: what lies within `radius_m`, nearest first. Venues without "
    "an anchor, and their levels, are not found.",
    examples=["48.1507,11.5691"],
)
_Radius = Query(gt=0, le=MAX_RADIUS_M, description="Metres; only with `near`.")
_Box = Query(
    max_length=128,
    description="`lon_min,lat_min,lon_max,lat_max` in degrees (RFC 7946, also across the antimeridian): what touches "
    "it. Not together with `near`.",
    examples=["11.5,48.1,11.6,48.2"],
)
_Words = Query(
    min_length=1,
    max_length=200,
    pattern=LINE_PATTERN,
    description="Words of the name, or their beginnings, in any order; a level's name and its venue's count.",
)


async def _search(
    near: Annotated[str | None, _Near] = None,
    radius_m: Annotated[float, _Radius] = DEFAULT_RADIUS_M,
    bbox: Annotated[str | None, _Box] = None,
    q: Annotated[str | None, _Words] = None,
) -> Search:
    if near is not None and bbox is not None:
        raise RejectedError([FieldError("bbox", "is sent beside near", "send one of the two")])
    return Search(
        near=None if near is None else _near(near, radius_m),
        box=None if bbox is None else _box(bbox),
        words=() if q is None else query_words(q),
    )


def _near(text: str, radius_m: float) -> Near:
    latitude, longitude = _degrees("near", text, ("latitude", "longitude"))
    return Near(latitude, longitude, radius_m)


def _box(text: str) -> GeoBox:
    west, south, east, north = _degrees("bbox", text, ("longitude", "latitude", "longitude", "latitude"))
    if south > north:
        raise RejectedError([FieldError("bbox", "ends south of where it begins", "give lat_min <= lat_max")])
    # lon_min > lon_max: across the antimeridian
    first = -180.0 if west == 180.0 else west
    return GeoBox(south, first, north, east if east >= first else east + 360.0)


def _degrees(field: str, text: str, wanted: tuple[str, ...]) -> list[float]:
    values = [_degree(part) for part in text.split(",")]
    bounds = [90.0 if name == "latitude" else 180.0 for name in wanted]
    if len(values) != len(wanted) or not all(abs(v) <= bound for v, bound in zip(values, bounds, strict=True)):
        remedy = f"send {','.join(wanted)} in degrees, with commas between them"
        raise RejectedError([FieldError(field, f"is not {len(wanted)} numbers in range", remedy)])
    return values


def _degree(text: str) -> float:
    try:
        return float(text) if len(text) <= 32 else math.nan
    except ValueError:
        return math.nan


SearchDep = Annotated[Search, Depends(_search)]
