"""Tracks as CSV: a row a fix, whatever it claims; level metres, and degrees where the venue has an anchor."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator

from app.engine.geodesy import TangentPlane
from app.exchange.tracks.document import TrackDocument, TrackPoint, degrees_of, iso_time, spread_of

COLUMNS = (
    "number",
    "seq",
    "time",
    "t_ms",
    "kind",
    "level_id",
    "x_m",
    "y_m",
    "cov_xx_m2",
    "cov_xy_m2",
    "cov_yy_m2",
    "sd_major_m",
    "sd_minor_m",
    "heading_deg",
    "status",
    "sure",
    "quality",
    "latitude_deg",
    "longitude_deg",
)
_ROWS = 500
"""Rows of one piece."""


def write_csv(document: TrackDocument, points: Iterable[TrackPoint]) -> Iterator[bytes]:
    """A header and a row a fix. No cell needs quotes: all are numbers, times, ids and fixed words."""
    rows = [",".join(COLUMNS)]
    for point in points:
        rows.append(",".join(_cells(point, document.plane)))
        if len(rows) >= _ROWS:
            yield _lines(rows)
            rows = []
    if rows:
        yield _lines(rows)


def _cells(point: TrackPoint, plane: TangentPlane | None) -> tuple[str, ...]:
    fix, spread = point.fix, spread_of(point.fix)
    longitude, latitude = ("", "") if plane is None else (f"{degree:.8f}" for degree in degrees_of(fix, plane))
    return (
        str(point.number),
        "" if point.seq is None else str(point.seq),
        iso_time(fix.t),
        f"{fix.t * 1000.0:.3f}",
        fix.kind.value,
        fix.level_id,
        f"{fix.x:.3f}",
        f"{fix.y:.3f}",
        f"{fix.cov_xx:.6g}",
        f"{fix.cov_xy:.6g}",
        f"{fix.cov_yy:.6g}",
        f"{spread.major_m:.3f}",
        f"{spread.minor_m:.3f}",
        f"{_heading_deg(fix.heading):.2f}",
        fix.status.value,
        "true" if fix.sure else "false",
        f"{fix.quality:.4f}",
        latitude,
        longitude,
    )


def _heading_deg(heading: float) -> float:
    """Degrees counter-clockwise from +x, 0 to 360; what rounds up to 360 is 0."""
    return round(math.degrees(heading) % 360.0, 2) % 360.0


def _lines(rows: list[str]) -> bytes:
    return ("\r\n".join(rows) + "\r\n").encode()
