"""Where venues and levels are on earth, and how rows near a place are found with a plain index.

Every row has its box in WGS 84 and a key, the band: boxes of up to 2 km lie in bands of latitude 2 km high, larger ones
in higher bands of their own (a loose quadtree's idea, Ulrich, Game Programming Gems 2000, in one dimension). With an
index on band and longitude of the centre a search reads only what lies in its own few bands and its own longitudes,
whatever else is stored. All of it is portable SQL.
"""

from __future__ import annotations

import math
import struct
from typing import Any

from sqlalchemy import ColumnElement, FromClause, Table, and_, case, literal, or_

from app.engine.geodesy import GeoBox, metres_per_degree
from app.services.errors import InvalidError
from app.services.search import Near
from app.storage.models import name_words

_REACH_DEG = (0.01, 0.3, 20.0)
"""Half sizes of boxes, in degrees of latitude, up to which they are kept in bands twice as high: 1, 33 and 2,200 km."""
_EVERYWHERE = len(_REACH_DEG)
_CLASS = 1_000_000
_MANY_BANDS = 64
"""So many bands are named one by one; more are a range, in which longitudes are only filtered."""
_LAST = "\U0010ffff"


def box_columns(box: GeoBox | None) -> dict[str, float | int | None]:
    """Columns of a row that lies in this box, or nowhere."""
    if box is None:
        return dict.fromkeys(("south_deg", "west_deg", "north_deg", "east_deg", "place_band", "place_lon"))
    latitude, longitude = 0.5 * (box.south_deg + box.north_deg), 0.5 * (box.west_deg + box.east_deg)
    return {
        "south_deg": box.south_deg,
        "west_deg": box.west_deg,
        "north_deg": box.north_deg,
        "east_deg": box.east_deg,
        "place_band": _band(_class_of(box), latitude),
        "place_lon": (longitude + 180.0) % 360.0 - 180.0,
    }


def box_of(row: Any) -> GeoBox | None:
    """The box of a row."""
    return None if row.south_deg is None else GeoBox(row.south_deg, row.west_deg, row.north_deg, row.east_deg)


def _class_of(box: GeoBox) -> int:
    high = 0.5 * (box.north_deg - box.south_deg)
    wide = 0.5 * (box.east_deg - box.west_deg) * math.cos(math.radians(max(abs(box.south_deg), abs(box.north_deg))))
    if box.east_deg - box.west_deg >= 360.0:
        return _EVERYWHERE
    return next((k for k, reach in enumerate(_REACH_DEG) if max(high, wide) <= reach), _EVERYWHERE)


def _band(size: int, latitude_deg: float) -> int:
    row = 0 if size == _EVERYWHERE else math.floor((latitude_deg + 90.0) / (2.0 * _REACH_DEG[size]))
    return size * _CLASS + row


def touches(table: Table, box: GeoBox) -> ColumnElement[bool]:
    """Whether a row's box and this one have a point in common; the index is asked first."""
    c = table.c
    latitudes = and_(c.south_deg <= box.north_deg, c.north_deg >= box.south_deg)
    longitudes = or_(*(_turn_overlaps(table, box, turn) for turn in (-360.0, 0.0, 360.0)))
    return and_(or_(*_windows(table, box)), latitudes, longitudes)


def _turn_overlaps(table: FromClause, box: GeoBox, turn: float) -> ColumnElement[bool]:
    return and_(table.c.west_deg <= box.east_deg + turn, table.c.east_deg >= box.west_deg + turn)


def _windows(table: Table, box: GeoBox) -> list[ColumnElement[bool]]:
    """Ranges of the index that hold every row that can touch the box."""
    found: list[ColumnElement[bool]] = [table.c.place_band == _band(_EVERYWHERE, 0.0)]
    for size, reach in enumerate(_REACH_DEG):
        first = _band(size, max(box.south_deg - reach, -90.0))
        last = _band(size, min(box.north_deg + reach, 90.0))
        if last - first >= _MANY_BANDS:
            bands: ColumnElement[bool] = table.c.place_band.between(first, last)
        elif first == last:
            bands = table.c.place_band == first
        else:
            bands = table.c.place_band.in_(range(first, last + 1))
        found += [and_(bands, table.c.place_lon.between(*window)) for window in _longitudes(box, reach)]
    return found


def _longitudes(box: GeoBox, reach_deg: float) -> list[tuple[float, float]]:
    """Where the centres of boxes of a class can lie that touch the box: one range, or two across the antimeridian.

    A box that touches reaches at most twice ``reach_deg`` farther from the equator, where degrees are shorter still.
    """
    farthest = max(abs(box.south_deg), abs(box.north_deg)) + 2.0 * reach_deg
    margin = reach_deg / math.cos(math.radians(farthest)) if farthest < 89.9 else 360.0
    west, wide = box.west_deg - margin, box.east_deg - box.west_deg + 2.0 * margin
    if wide >= 360.0:
        return [(-180.0, 180.0)]
    west = (west + 180.0) % 360.0 - 180.0
    return [(west, west + wide)] if west + wide <= 180.0 else [(west, 180.0), (-180.0, west + wide - 360.0)]


def squared_distance(table: FromClause, near: Near) -> ColumnElement[float]:
    """Square of the distance from a place to the row's box, m^2; 0 inside it.

    Only for rows that touch the disc's box.
    """
    north_m, east_m = metres_per_degree(near.latitude_deg)
    box, c = near.box(), table.c
    up = _gap(c.south_deg, c.north_deg, near.latitude_deg) * north_m
    lon = near.longitude_deg
    # the box of the disc begins in [-180, 180), and so the place may be a turn away from the row
    lon += 360.0 * round((0.5 * (box.west_deg + box.east_deg) - lon) / 360.0)
    gaps = [(_turn_overlaps(table, box, turn), _gap(c.west_deg, c.east_deg, lon + turn)) for turn in (0.0, 360.0)]
    across = case(*gaps, else_=_gap(c.west_deg, c.east_deg, lon - 360.0)) * east_m
    return up * up + across * across


def _gap(low: ColumnElement[Any], high: ColumnElement[Any], value: float) -> ColumnElement[float]:
    """How far a value lies outside an interval."""
    return case((low > value, low - value), (high < value, value - high), else_=literal(0.0))


def begins(word: str) -> ColumnElement[bool]:
    """Whether a word of a name begins with this one."""
    return and_(name_words.c.word >= word, name_words.c.word < word + _LAST)


def near_cursor(squared_m2: float, id_: str) -> str:
    """Cursor after a row of a list by distance; holds the distance to the bit."""
    return f"{struct.pack('>d', squared_m2).hex()}_{id_}"


def from_near_cursor(cursor: str) -> tuple[float, str]:
    """Inverse of :func:`near_cursor`; InvalidError for a cursor of another list."""
    head, _, id_ = cursor.partition("_")
    try:
        (squared,) = struct.unpack(">d", bytes.fromhex(head))
    except (ValueError, struct.error) as error:
        remedy = "give next_cursor of the page before, with the same query"
        raise InvalidError("cursor", f"{cursor!r} is not a cursor of this list", remedy) from error
    return squared, id_
