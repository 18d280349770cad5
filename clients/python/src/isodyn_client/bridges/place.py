"""From level metres to WGS 84: the venue's anchor, and what a fix is on the earth."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from isodyn_client.follow import PlanFix
from isodyn_client.models import Anchor, Status

# WGS 84 (NGA.STND.0036, 2014): semi-major axis in m, flattening; the rest follows.
_A = 6378137.0
_F = 1 / 298.257223563
_B = _A * (1 - _F)
_E2 = _F * (2 - _F)
_SECOND_E2 = _E2 / (1 - _E2)

_MIN_SPAN_S, _MAX_SPAN_S = 1.0, 5.0
"""A speed is told over so long: shorter and it is the noise of two fixes, longer and it is old."""
_STILL_M_S = 0.25
"""Slower than this a direction of motion means nothing."""


@dataclass(frozen=True, slots=True)
class GeoFix:
    """One fix on the earth.

    Attributes
    ----------
    t : float, Unix s
    latitude_deg, longitude_deg : float, WGS 84
    var_east, cov_east_north, var_north : float, m^2
    course_deg : float or None
        Direction of motion, clockwise from true north; None at rest.
    speed_m_s : float or None
        Over ground; None where it is not known.
    claimed : bool
        Whether it may be passed on as a position; the others only say that there is none now.
    number : int
        Of the fix in its session.
    """

    t: float
    latitude_deg: float
    longitude_deg: float
    var_east: float
    cov_east_north: float
    var_north: float
    course_deg: float | None
    speed_m_s: float | None
    claimed: bool
    number: int

    @property
    def sd_east(self) -> float:
        """Standard deviation to the east, m."""
        return math.sqrt(max(self.var_east, 0.0))

    @property
    def sd_north(self) -> float:
        """Standard deviation to the north, m."""
        return math.sqrt(max(self.var_north, 0.0))

    @property
    def rms_m(self) -> float:
        """Root mean square of the horizontal error, m."""
        return math.sqrt(max(self.var_east + self.var_north, 0.0))

    @property
    def ellipse(self) -> tuple[float, float, float]:
        """Semi-axes of the error ellipse, one standard deviation, m, and the azimuth of the major one, degrees
        clockwise from true north, 0 to 180."""
        half_sum = (self.var_north + self.var_east) / 2
        half_difference = (self.var_north - self.var_east) / 2
        spread = math.hypot(half_difference, self.cov_east_north)
        azimuth = math.degrees(0.5 * math.atan2(self.cov_east_north, half_difference)) % 180.0
        return math.sqrt(max(half_sum + spread, 0.0)), math.sqrt(max(half_sum - spread, 0.0)), azimuth


@dataclass(slots=True)
class Georeference:
    """Takes a session's fixes to the earth, in order.

    Attributes
    ----------
    anchor : Anchor
    sure_only : bool
        Claim only fixes that are ``sure``; else all with status ``ok`` (for methods that call none sure).
    """

    anchor: Anchor
    sure_only: bool = True
    _recent: list[PlanFix] = field(default_factory=list)

    def place(self, fix: PlanFix) -> GeoFix:
        """One fix; the ones before it tell the speed."""
        claimed = fix.status is Status.OK and (fix.sure or not self.sure_only)
        speed = self._speed(fix) if claimed else None
        sine, cosine = math.sin(math.radians(self.anchor.bearing_deg)), math.cos(math.radians(self.anchor.bearing_deg))
        latitude, longitude = self.degrees(fix.x, fix.y)
        # +x points cosine east and -sine north, +y sine east and cosine north
        xx, xy, yy = fix.cov_xx, fix.cov_xy, fix.cov_yy
        return GeoFix(
            t=fix.t_ms / 1000.0,
            latitude_deg=latitude,
            longitude_deg=longitude,
            var_east=cosine**2 * xx + 2 * sine * cosine * xy + sine**2 * yy,
            cov_east_north=sine * cosine * (yy - xx) + (cosine**2 - sine**2) * xy,
            var_north=sine**2 * xx - 2 * sine * cosine * xy + cosine**2 * yy,
            course_deg=None if speed is None or speed < _STILL_M_S else self.azimuth(fix.heading_deg),
            speed_m_s=speed,
            claimed=claimed,
            number=fix.number,
        )

    def azimuth(self, heading_deg: float) -> float:
        """Degrees clockwise from true north of a direction counter-clockwise from +x."""
        return (self.anchor.bearing_deg + 90.0 - heading_deg) % 360.0

    def degrees(self, x: float, y: float) -> tuple[float, float]:
        """Latitude and longitude of a point of the level: through earth-centred coordinates and back by Bowring's
        closed form (Survey Review 23 (181), 1976)."""
        bearing = math.radians(self.anchor.bearing_deg)
        east = x * math.cos(bearing) + y * math.sin(bearing)
        north = y * math.cos(bearing) - x * math.sin(bearing)
        latitude, longitude = math.radians(self.anchor.latitude_deg), math.radians(self.anchor.longitude_deg)
        sin_lat, cos_lat = math.sin(latitude), math.cos(latitude)
        normal = _A / math.sqrt(1 - _E2 * sin_lat**2)
        along = (normal + self.anchor.height_m) * cos_lat - north * sin_lat
        polar = (normal * (1 - _E2) + self.anchor.height_m) * sin_lat + north * cos_lat
        first = along * math.cos(longitude) - east * math.sin(longitude)
        second = along * math.sin(longitude) + east * math.cos(longitude)
        radius = math.hypot(first, second)
        parametric = math.atan2(polar * _A, radius * _B)
        turned = math.atan2(
            polar + _SECOND_E2 * _B * math.sin(parametric) ** 3, radius - _E2 * _A * math.cos(parametric) ** 3
        )
        return math.degrees(turned), math.degrees(math.atan2(second, first))

    def _speed(self, fix: PlanFix) -> float | None:
        """Way over time since the claimed fix of one to five seconds ago on the same level."""
        first = self._recent[0].t_ms if self._recent else fix.t_ms
        if first > fix.t_ms or (self._recent and self._recent[0].level_id != fix.level_id):
            self._recent.clear()
        self._recent = [one for one in self._recent if fix.t_ms - one.t_ms <= _MAX_SPAN_S * 1000.0]
        before = [one for one in self._recent if fix.t_ms - one.t_ms >= _MIN_SPAN_S * 1000.0]
        self._recent.append(fix)
        if not before:
            return None
        start = before[-1]
        return math.hypot(fix.x - start.x, fix.y - start.y) / ((fix.t_ms - start.t_ms) / 1000.0)
