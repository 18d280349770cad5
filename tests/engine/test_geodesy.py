"""Plan metres and WGS 84: against the definition of the ellipsoid, and there and back."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.engine.geodesy import GeoBox, TangentPlane, metres_per_degree

latitudes = st.floats(-85.0, 85.0)
longitudes = st.floats(-180.0, 180.0)
bearings = st.floats(-360.0, 360.0)
offsets = st.floats(-2000.0, 2000.0)


def ecef(longitude_deg: float, latitude_deg: float, height_m: float = 0.0) -> np.ndarray:
    """Earth-centred coordinates by the definition of the ellipsoid."""
    a, f = 6378137.0, 1 / 298.257223563
    lon, lat = math.radians(longitude_deg), math.radians(latitude_deg)
    e2 = f * (2 - f)
    normal = a / math.sqrt(1 - e2 * math.sin(lat) ** 2)
    return np.array(
        [
            (normal + height_m) * math.cos(lat) * math.cos(lon),
            (normal + height_m) * math.cos(lat) * math.sin(lon),
            (normal * (1 - e2) + height_m) * math.sin(lat),
        ]
    )


def local(anchor: TangentPlane, longitude_deg: float, latitude_deg: float) -> np.ndarray:
    """East and north of a place from the anchor, by rotating earth-centred differences."""
    lon, lat = math.radians(anchor.longitude_deg), math.radians(anchor.latitude_deg)
    east = np.array([-math.sin(lon), math.cos(lon), 0.0])
    north = np.array([-math.sin(lat) * math.cos(lon), -math.sin(lat) * math.sin(lon), math.cos(lat)])
    difference = ecef(longitude_deg, latitude_deg, anchor.height_m) - ecef(
        anchor.longitude_deg, anchor.latitude_deg, anchor.height_m
    )
    return np.array([difference @ east, difference @ north])


@given(latitude=latitudes, longitude=longitudes, bearing=bearings, x=offsets, y=offsets)
def test_points_lie_where_the_plan_says(latitude: float, longitude: float, bearing: float, x: float, y: float) -> None:
    anchor = TangentPlane(latitude, longitude, bearing, height_m=300.0)
    found = local(anchor, *anchor.to_wgs84(x, y))
    angle = math.radians(bearing)
    expected = [x * math.cos(angle) + y * math.sin(angle), y * math.cos(angle) - x * math.sin(angle)]
    np.testing.assert_allclose(found, expected, atol=2e-3)


@given(latitude=latitudes, longitude=longitudes, bearing=bearings)
def test_the_origin_is_the_anchor(latitude: float, longitude: float, bearing: float) -> None:
    lon, lat = TangentPlane(latitude, longitude, bearing).to_wgs84(0.0, 0.0)
    assert lat == pytest.approx(latitude, abs=1e-9)
    assert math.cos(math.radians(lon - longitude)) == pytest.approx(1.0, abs=1e-12)


def test_bearing_turns_clockwise_from_north() -> None:
    lon, lat = TangentPlane(48.0, 11.0, bearing_deg=90.0).to_wgs84(0.0, 100.0)
    assert lon > 11.0
    assert lat == pytest.approx(48.0, abs=1e-6)
    lon, lat = TangentPlane(48.0, 11.0, bearing_deg=0.0).to_wgs84(0.0, 100.0)
    assert lon == pytest.approx(11.0, abs=1e-9)
    # a minute of latitude is a nautical mile, 1852 m, give or take the flattening
    assert (lat - 48.0) * 60 * 1852 == pytest.approx(100.0, rel=0.01)


@given(
    latitude=latitudes,
    longitude=longitudes,
    bearing=bearings,
    height=st.floats(-500.0, 9000.0),
    x=st.floats(-1e5, 1e5),
    y=st.floats(-1e5, 1e5),
)
def test_there_and_back(latitude: float, longitude: float, bearing: float, height: float, x: float, y: float) -> None:
    plane = TangentPlane(latitude, longitude, bearing, height)
    lon, lat = plane.to_wgs84(x, y)
    found_x, found_y = plane.from_wgs84(np.array([lat]), np.array([lon]))
    # Bowring's latitude is good to nanometres near the ground; the plane leaves it by 800 m at 100 km
    np.testing.assert_allclose([found_x[0], found_y[0]], [x, y], rtol=0, atol=1e-5)


@given(latitude=latitudes, longitude=longitudes, x=offsets, y=offsets)
def test_places_are_found_in_the_plan(latitude: float, longitude: float, x: float, y: float) -> None:
    """Earth-centred differences are the slow twin; heights matter little this near."""
    plane = TangentPlane(latitude, longitude, 0.0, 120.0)
    lat = latitude + math.degrees(y / 6378137.0)
    lon = longitude + math.degrees(x / 6378137.0)
    found_x, found_y = plane.from_wgs84(np.array([lat]), np.array([lon]))
    np.testing.assert_allclose([found_x[0], found_y[0]], local(plane, lon, lat), rtol=0, atol=2e-3)


def test_many_places_at_once() -> None:
    plane = TangentPlane(48.15, 11.57, 12.5, 515.0)
    points = [(0.0, 0.0), (30.0, -12.0), (-500.0, 900.0)]
    lon, lat = np.array([plane.to_wgs84(*point) for point in points]).T
    np.testing.assert_allclose(np.stack(plane.from_wgs84(lat, lon), axis=1), points, atol=1e-6)
    empty_x, empty_y = plane.from_wgs84(np.zeros(0), np.zeros(0))
    assert (len(empty_x), len(empty_y)) == (0, 0)


@given(latitude=latitudes, longitude=longitudes, bearing=st.floats(0.0, 360.0), x=offsets, y=offsets)
def test_many_points_are_many_times_one(latitude: float, longitude: float, bearing: float, x: float, y: float) -> None:
    plane = TangentPlane(latitude, longitude, bearing, 515.0)
    xs, ys = np.array([[x, 0.0], [y, x]]), np.array([[y, 0.0], [x, x]])
    lon, lat = plane.arrays_to_wgs84(xs, ys)
    expected = np.array([plane.to_wgs84(float(a), float(b)) for a, b in zip(xs.ravel(), ys.ravel(), strict=True)])
    np.testing.assert_allclose(np.stack([lon.ravel(), lat.ravel()], axis=1), expected, rtol=0, atol=1e-11)


def test_the_other_side_of_the_earth_is_nowhere() -> None:
    plane = TangentPlane(48.15, 11.57)
    x, y = plane.from_wgs84(np.array([-48.15, 48.15, 48.15]), np.array([-168.43, 130.0, 11.57]))
    assert np.isnan(x).tolist() == np.isnan(y).tolist() == [True, True, False]


@pytest.mark.parametrize("latitude", [0.0, 48.15, -75.0])
@pytest.mark.parametrize("longitude", [11.57, 179.999, -180.0])
@pytest.mark.parametrize("bearing", [0.0, 30.0, 200.0])
def test_the_box_of_a_rectangle_holds_it_and_no_more(latitude: float, longitude: float, bearing: float) -> None:
    plane = TangentPlane(latitude, longitude, bearing)
    box = plane.bounds(-300.0, 10.0, 900.0, 400.0)
    assert -180.0 <= box.west_deg < 180.0
    x, y = np.meshgrid(np.linspace(-300.0, 900.0, 13), np.linspace(10.0, 400.0, 5))
    places = np.array([plane.to_wgs84(float(a), float(b)) for a, b in zip(x.ravel(), y.ravel(), strict=True)])
    east = (places[:, 0] - box.west_deg + 1e-12) % 360.0
    width = box.east_deg - box.west_deg
    assert east.max() <= width + 1e-7
    assert (places[:, 1].min(), places[:, 1].max()) == pytest.approx((box.south_deg, box.north_deg), abs=5e-7)
    assert width == pytest.approx(east.max() - east.min(), abs=1e-7)


def test_a_box_near_a_pole_takes_all_longitudes() -> None:
    for latitude in (89.9, -89.9):
        box = TangentPlane(latitude, 0.0).bounds(-100.0, -100.0, 100.0, 100.0)
        assert box.east_deg - box.west_deg == 360.0
        assert 90.0 in (box.north_deg, -box.south_deg)
    assert GeoBox.around(89.5, 10.0, 30_000.0).east_deg == 180.0


def test_a_box_around_a_place_holds_the_disc() -> None:
    for latitude, longitude in ((0.0, 0.0), (60.0, 179.9), (-80.0, -179.9)):
        box, plane = GeoBox.around(latitude, longitude, 5_000.0), TangentPlane(latitude, longitude)
        for angle in np.linspace(0.0, 2.0 * np.pi, 36):
            lon, lat = plane.to_wgs84(5_000.0 * np.cos(angle), 5_000.0 * np.sin(angle))
            assert box.south_deg <= lat <= box.north_deg
            assert (lon - box.west_deg) % 360.0 <= box.east_deg - box.west_deg


def test_boxes_are_joined_the_short_way_round() -> None:
    east, west = GeoBox(0.0, 179.0, 1.0, 179.5), GeoBox(-2.0, -179.5, -1.0, -179.0)
    for joined in (east.union(west), west.union(east)):
        assert joined == GeoBox(-2.0, 179.0, 1.0, 181.0)
    assert east.union(east) == east
    halves = GeoBox(0.0, -180.0, 1.0, 20.0).union(GeoBox(0.0, 0.0, 1.0, 179.0))
    assert halves.east_deg - halves.west_deg == pytest.approx(359.0)


def test_degrees_are_as_long_as_on_the_ellipsoid() -> None:
    """Lengths of a degree of latitude and longitude, WGS 84 (NGA.STND.0036), at 0 and 45 degrees."""
    assert metres_per_degree(0.0) == pytest.approx((110_574.3, 111_319.5), abs=0.1)
    assert metres_per_degree(45.0) == pytest.approx((111_131.8, 78_846.8), abs=0.1)
