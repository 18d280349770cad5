from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.api.geojson import LevelToWgs84, feature_collection
from app.api.schemas.positions import GEO_JSON_EXAMPLE
from app.engine.types import Hypothesis
from app.services.records import Anchor, Position
from tests.support.builders import fix


def test_a_point_carries_its_level_and_all_places_that_fit() -> None:
    places = (Hypothesis("lvl", 1.0, 2.0, 3.0, 0.5, 2.0, 0.75), Hypothesis("lvl_2", 4.0, 5.0, 1.0, 0.0, 1.0, 0.25))
    position = Position("ses", 7, 3, replace(fix(), hypotheses=places))
    (feature,) = feature_collection([position], Anchor(48.0, 11.0), None)["features"]
    properties = feature["properties"]
    assert properties["level_id"] == "lvl"
    assert [(h["level_id"], h["weight"]) for h in properties["hypotheses"]] == [("lvl", 0.75), ("lvl_2", 0.25)]
    assert properties.keys() == GEO_JSON_EXAMPLE["features"][0]["properties"].keys()


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


def local(anchor: Anchor, longitude_deg: float, latitude_deg: float) -> np.ndarray:
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
    anchor = Anchor(latitude, longitude, bearing, height_m=300.0)
    found = local(anchor, *LevelToWgs84(anchor)(x, y))
    angle = math.radians(bearing)
    expected = [x * math.cos(angle) + y * math.sin(angle), y * math.cos(angle) - x * math.sin(angle)]
    np.testing.assert_allclose(found, expected, atol=2e-3)


@given(latitude=latitudes, longitude=longitudes, bearing=bearings)
def test_the_origin_is_the_anchor(latitude: float, longitude: float, bearing: float) -> None:
    lon, lat = LevelToWgs84(Anchor(latitude, longitude, bearing))(0.0, 0.0)
    assert lat == pytest.approx(latitude, abs=1e-9)
    assert math.cos(math.radians(lon - longitude)) == pytest.approx(1.0, abs=1e-12)


def test_bearing_turns_clockwise_from_north() -> None:
    lon, lat = LevelToWgs84(Anchor(48.0, 11.0, bearing_deg=90.0))(0.0, 100.0)
    assert lon > 11.0
    assert lat == pytest.approx(48.0, abs=1e-6)
    lon, lat = LevelToWgs84(Anchor(48.0, 11.0, bearing_deg=0.0))(0.0, 100.0)
    assert lon == pytest.approx(11.0, abs=1e-9)
    # a minute of latitude is a nautical mile, 1852 m, give or take the flattening
    assert (lat - 48.0) * 60 * 1852 == pytest.approx(100.0, rel=0.01)
