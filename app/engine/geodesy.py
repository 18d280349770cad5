"""WGS 84 and the level frame: a venue's levels are the tangent plane at its anchor."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from app.engine.types import Float64Array

# WGS 84 (NGA.STND.0036, 2014): semi-major axis in m, flattening; the rest follows.
_A = 6378137.0
_F = 1 / 298.257223563
_B = _A * (1 - _F)
_E2 = _F * (2 - _F)
_SECOND_E2 = _E2 / (1 - _E2)

_LEAST_COSINE = 0.5
"""Farther round the earth than this (60 degrees) a tangent plane stands for nothing."""
_POLAR_DEG = 89.0
"""Nearer to a pole than this a box of longitudes tells nothing."""


@dataclass(frozen=True, slots=True)
class GeoBox:
    """A rectangle of latitude and longitude, degrees, WGS 84.

    Attributes
    ----------
    south_deg, north_deg : float
    west_deg, east_deg : float
        ``west_deg`` is in [-180, 180), ``east_deg`` not less: beyond 180 for a box across the antimeridian.
    """

    south_deg: float
    west_deg: float
    north_deg: float
    east_deg: float

    @classmethod
    def around(cls, latitude_deg: float, longitude_deg: float, radius_m: float) -> GeoBox:
        """The box that holds a disc on the ellipsoid; the whole circle of longitudes where the disc holds a pole."""
        north_m, _ = metres_per_degree(latitude_deg)
        reach = 1.01 * radius_m / north_m  # a degree is longer nearer to the poles, by 1 % from the equator to there
        south, north = max(latitude_deg - reach, -90.0), min(latitude_deg + reach, 90.0)
        farthest = max(abs(south), abs(north))
        if farthest > _POLAR_DEG:
            return cls(south, -180.0, north, 180.0)
        wide = reach / math.cos(math.radians(farthest))
        return cls(south, _turned(longitude_deg - wide), north, _turned(longitude_deg - wide) + 2.0 * wide)

    def union(self, other: GeoBox) -> GeoBox:
        """The smallest box that holds both."""
        south, north = min(self.south_deg, other.south_deg), max(self.north_deg, other.north_deg)
        wests = []
        for first, second in ((self, other), (other, self)):
            ahead = (second.west_deg - first.west_deg) % 360.0
            wide = max(first.east_deg - first.west_deg, ahead + second.east_deg - second.west_deg)
            wests.append((wide, first.west_deg))
        wide, west = min(wests)
        return GeoBox(south, -180.0, north, 180.0) if wide >= 360.0 else GeoBox(south, west, north, west + wide)


def metres_per_degree(latitude_deg: float) -> tuple[float, float]:
    """Metres that a degree of latitude and one of longitude measure on the ellipsoid at a latitude."""
    sine, cosine = math.sin(math.radians(latitude_deg)), math.cos(math.radians(latitude_deg))
    normal = _A / math.sqrt(1 - _E2 * sine**2)
    meridian = normal * (1 - _E2) / (1 - _E2 * sine**2)
    return math.radians(meridian), math.radians(normal * cosine)


def _turned(longitude_deg: float) -> float:
    """The same longitude in [-180, 180)."""
    return (longitude_deg + 180.0) % 360.0 - 180.0


@dataclass(frozen=True, slots=True)
class TangentPlane:
    """Takes plan metres to WGS 84 and back.

    Attributes
    ----------
    latitude_deg, longitude_deg : float
        Of the frame's origin.
    bearing_deg : float
        Of +y, clockwise from true north.
    height_m : float
        Of the origin above the ellipsoid.
    """

    latitude_deg: float
    longitude_deg: float
    bearing_deg: float = 0.0
    height_m: float = 0.0

    def to_wgs84(self, x: float, y: float) -> tuple[float, float]:
        """Longitude and latitude, degrees, of a point of the plane.

        The point goes through earth-centred coordinates, so the only approximation is Bowring's closed form back to
        latitude (Survey Review 23 (181), 1976), exact to nanometres here.
        """
        bearing = math.radians(self.bearing_deg)
        east = x * math.cos(bearing) + y * math.sin(bearing)
        north = y * math.cos(bearing) - x * math.sin(bearing)
        return _to_degrees(*self._earth_centred(east, north))

    def bounds(self, x_min: float, y_min: float, x_max: float, y_max: float) -> GeoBox:
        """The box of a rectangle of the plane.

        Corners and middles of the sides are looked at: between them a side of 20 km leaves the box by a few metres, and
        nearer than a degree to a pole the box takes all longitudes.
        """
        x_mid, y_mid = 0.5 * (x_min + x_max), 0.5 * (y_min + y_max)
        edge = [(x, y) for x in (x_min, x_mid, x_max) for y in (y_min, y_mid, y_max)]
        places = [self.to_wgs84(x, y) for x, y in edge]
        south, north = min(lat for _, lat in places), max(lat for _, lat in places)
        if max(abs(south), abs(north)) > _POLAR_DEG:
            return GeoBox(-90.0 if south < 0 else south, -180.0, 90.0 if north > 0 else north, 180.0)
        turns = [_turned(lon - self.longitude_deg) for lon, _ in places]
        west = _turned(self.longitude_deg + min(turns))
        return GeoBox(south, west, north, west + max(turns) - min(turns))

    def arrays_to_wgs84(self, x: Float64Array, y: Float64Array) -> tuple[Float64Array, Float64Array]:
        """Longitude and latitude, degrees, of points of the plane; arrays of one shape. :meth:`to_wgs84` of each."""
        bearing = math.radians(self.bearing_deg)
        east = x * math.cos(bearing) + y * math.sin(bearing)
        north = y * math.cos(bearing) - x * math.sin(bearing)
        axes = self._axes()
        origin = np.array(self._earth_centred(0.0, 0.0))
        place = origin[:, None] + np.outer(axes[0], east) + np.outer(axes[1], north)
        radius = np.hypot(place[0], place[1])
        parametric = np.arctan2(place[2] * _A, radius * _B)
        latitude = np.arctan2(
            place[2] + _SECOND_E2 * _B * np.sin(parametric) ** 3, radius - _E2 * _A * np.cos(parametric) ** 3
        )
        longitude: Float64Array = np.degrees(np.arctan2(place[1], place[0])).reshape(x.shape)
        return longitude, np.degrees(latitude).reshape(x.shape)

    def from_wgs84(self, latitude_deg: Float64Array, longitude_deg: Float64Array) -> tuple[Float64Array, Float64Array]:
        """Plan metres (x, y) of places, each of shape (n,); the inverse of :meth:`to_wgs84`.

        Heights are not asked for: a place is where its plumb line (the normal of the ellipsoid) meets the plane. NaN
        for places more than 60 degrees round the earth.
        """
        lat, lon = np.radians(latitude_deg), np.radians(longitude_deg)
        sin_lat, cos_lat = np.sin(lat), np.cos(lat)
        radius = _A / np.sqrt(1 - _E2 * sin_lat**2)
        normal = np.stack([cos_lat * np.cos(lon), cos_lat * np.sin(lon), sin_lat])
        ground = normal * np.stack([radius, radius, radius * (1 - _E2)])
        axes = self._axes()
        origin = np.array(self._earth_centred(0.0, 0.0))
        place, plumb = axes @ (ground - origin[:, None]), axes @ normal
        with np.errstate(divide="ignore", invalid="ignore"):
            east, north, _ = place - plumb * (place[2] / np.where(plumb[2] < _LEAST_COSINE, np.nan, plumb[2]))
        bearing = math.radians(self.bearing_deg)
        x: Float64Array = east * math.cos(bearing) - north * math.sin(bearing)
        y: Float64Array = east * math.sin(bearing) + north * math.cos(bearing)
        return x, y

    def _axes(self) -> Float64Array:
        """East, north and up at the origin as rows, earth-centred."""
        lat, lon = math.radians(self.latitude_deg), math.radians(self.longitude_deg)
        return np.array(
            [
                [-math.sin(lon), math.cos(lon), 0.0],
                [-math.sin(lat) * math.cos(lon), -math.sin(lat) * math.sin(lon), math.cos(lat)],
                [math.cos(lat) * math.cos(lon), math.cos(lat) * math.sin(lon), math.sin(lat)],
            ]
        )

    def _earth_centred(self, east: float, north: float) -> tuple[float, float, float]:
        """Equatorial coordinates along and across the anchor's meridian, and the polar one, turned to Greenwich."""
        latitude, longitude = math.radians(self.latitude_deg), math.radians(self.longitude_deg)
        sin_lat, cos_lat = math.sin(latitude), math.cos(latitude)
        normal = _A / math.sqrt(1 - _E2 * sin_lat**2)
        along = (normal + self.height_m) * cos_lat - north * sin_lat
        polar = (normal * (1 - _E2) + self.height_m) * sin_lat + north * cos_lat
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
