"""What is written to a track file: the session's words, its points, and the stretches that may be drawn as a line."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from typing import Any

from app.engine.geodesy import TangentPlane
from app.engine.types import Fix, FixKind, Status

MAX_GAP_S = 10.0
"""A line does not run on over a longer silence: nobody told what lay between."""
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


@dataclass(frozen=True, slots=True)
class TrackPoint:
    """A fix, its number among those of its kind, and the segment that told it (None: all of them did)."""

    number: int
    fix: Fix
    seq: int | None = None


@dataclass(frozen=True, slots=True)
class TrackDocument:
    """What a file says about itself.

    Attributes
    ----------
    session_id, method, software : str
    kind : FixKind
    venue : str
        Name of the venue.
    levels : mapping
        Level id to name, of all levels the session may be on.
    map_ids : tuple of str
        Map versions that the fixes rest on.
    device_id : str or None
    plane : TangentPlane or None
        Takes level metres to WGS 84; None where the venue has no anchor.
    """

    session_id: str
    kind: FixKind
    venue: str
    levels: Mapping[str, str]
    method: str
    software: str
    map_ids: tuple[str, ...] = ()
    device_id: str | None = None
    plane: TangentPlane | None = None

    def level_name(self, level_id: str) -> str:
        """Name of a level; its id if it has gone."""
        return self.levels.get(level_id, level_id)

    def words(self) -> dict[str, object]:
        """The file's own words, for formats that take any."""
        return {
            "session_id": self.session_id,
            "device_id": self.device_id,
            "kind": self.kind.value,
            "venue": self.venue,
            "method": self.method,
            "map_ids": list(self.map_ids),
            "software": self.software,
        }


@dataclass(frozen=True, slots=True)
class Spread:
    """Standard deviations of a fix along the axes of its error ellipse, m; ``angle_deg`` of the major one,
    counter-clockwise from +x, 0 to 180."""

    major_m: float
    minor_m: float
    angle_deg: float

    def azimuth_deg(self, plane: TangentPlane) -> float:
        """Of the major axis, clockwise from true north, 0 to 180."""
        return (plane.bearing_deg + 90.0 - self.angle_deg) % 180.0


def spread_of(fix: Fix) -> Spread:
    """The error ellipse of a fix, one standard deviation."""
    half_sum = (fix.cov_xx + fix.cov_yy) / 2
    half_difference = (fix.cov_xx - fix.cov_yy) / 2
    half_spread = math.hypot(half_difference, fix.cov_xy)
    angle = math.degrees(0.5 * math.atan2(fix.cov_xy, half_difference)) % 180.0
    return Spread(math.sqrt(max(half_sum + half_spread, 0.0)), math.sqrt(max(half_sum - half_spread, 0.0)), angle)


def claims(fix: Fix) -> bool:
    """Whether the fix claims a position: what is ambiguous, off the map or too little is never drawn as a line."""
    return fix.status is Status.OK


@dataclass(slots=True)
class Stretch:
    """Points in a row that claim a position, all sure or all not, on one level, without a silence between."""

    points: list[TrackPoint] = field(default_factory=list)

    @property
    def level_id(self) -> str:
        """Level of all points."""
        return self.points[0].fix.level_id

    @property
    def sure(self) -> bool:
        """Whether all points may be acted on."""
        return self.points[0].fix.sure

    def takes(self, fix: Fix) -> bool:
        """Whether the line may run on to this fix."""
        if not self.points:
            return True
        last = self.points[-1].fix
        goes_on = 0.0 < fix.t - last.t <= MAX_GAP_S
        return goes_on and (fix.level_id, fix.sure) == (last.level_id, last.sure)


def stretches(points: Iterable[TrackPoint]) -> Iterator[Stretch]:
    """Points that claim a position as stretches, each as soon as it ends; the others end one and are left out."""
    current = Stretch()
    for point in points:
        claimed = claims(point.fix)
        if current.points and not (claimed and current.takes(point.fix)):
            yield current
            current = Stretch()
        if claimed:
            current.points.append(point)
    if current.points:
        yield current


def iso_time(t: float) -> str:
    """Unix seconds as ISO 8601 in UTC, to the millisecond."""
    when = _EPOCH + timedelta(milliseconds=round(t * 1000.0))
    return f"{when:%Y-%m-%dT%H:%M:%S}.{when.microsecond // 1000:03d}Z"


def plane_of(document: TrackDocument) -> TangentPlane:
    """The plane of a document that goes to WGS 84; ValueError without one: ``TrackFile.needs_anchor`` says so."""
    if document.plane is None:
        raise ValueError("a track without an anchor has no WGS 84")
    return document.plane


def dumped(value: Mapping[str, Any]) -> bytes:
    """JSON without spaces and without NaN."""
    return json.dumps(value, ensure_ascii=False, separators=(",", ":"), allow_nan=False).encode()


def degrees_of(fix: Fix, plane: TangentPlane) -> tuple[float, float]:
    """Longitude and latitude; 8 decimals are about a millimetre."""
    longitude, latitude = plane.to_wgs84(fix.x, fix.y)
    return round(longitude, 8), round(latitude, 8)
