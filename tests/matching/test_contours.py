"""Contours of a map, where they lie and what is nearest."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree

from app.engine.matching import read_map
from app.engine.matching.contours import ContourMap, edge_crossings
from app.engine.types import FeatureSet, GridMap
from tests.support.fields import field_map


@pytest.fixture
def grid_map() -> GridMap:
    return field_map(np.random.default_rng(2), features=FeatureSet.HV, shape=(60, 80))


def test_crossings_have_the_value(grid_map: GridMap) -> None:
    points = ContourMap.of(grid_map, FeatureSet.HV).crossings(1, -41.0)
    assert len(points) > 100
    np.testing.assert_allclose(read_map(grid_map, FeatureSet.HV, *points.T).mean[:, 1], -41.0, atol=1e-4)


def test_nearest_points_have_their_values_and_no_crossing_is_nearer(grid_map: GridMap) -> None:
    rng = np.random.default_rng(3)
    contours = ContourMap.of(grid_map, FeatureSet.TOTAL)
    xy = np.column_stack([rng.uniform(-8, 28, 100), rng.uniform(-18, 8, 100)])
    values = np.full(100, 50.0)
    found = contours.nearest(0, xy, values, 12.0)
    assert found.found.all()
    np.testing.assert_allclose(np.hypot(*(found.xy - xy).T), found.distance, atol=1e-9)
    reading = contours.planes[0]
    nodes = cKDTree(contours.metres(edge_crossings(reading, 50.0))).query(xy)[0]
    assert np.all(found.distance <= nodes + 1e-9)
    assert np.all(found.distance >= nodes - grid_map.cell_m)


def test_beyond_reach_the_point_itself_is_told(grid_map: GridMap) -> None:
    contours = ContourMap.of(grid_map, FeatureSet.TOTAL)
    xy = np.array([[3.0, 4.0]])
    found = contours.nearest(0, xy, np.array([1e4]), 5.0)
    assert not found.found.any()
    np.testing.assert_allclose(found.xy, xy)


def test_a_band_holds_the_places_that_a_reading_allows(grid_map: GridMap) -> None:
    rng = np.random.default_rng(4)
    contours = ContourMap.of(grid_map, FeatureSet.HV)
    for _ in range(20):
        x, y = rng.uniform(-9.0, 28.0), rng.uniform(-19.0, 8.0)
        values = read_map(grid_map, FeatureSet.HV, np.array([x]), np.array([y])).mean[0]
        points = contours.band(values, np.array([0.5, 0.5]))
        assert np.hypot(*(points - (x, y)).T).min() < 1.5 * grid_map.cell_m
        assert len(points) < 0.3 * grid_map.mean[0].size


def test_a_translated_map_has_translated_contours(grid_map: GridMap) -> None:
    moved = replace(grid_map, x0=grid_map.x0 + 7.0, y0=grid_map.y0 - 3.0)
    here, there = (ContourMap.of(one, FeatureSet.HV) for one in (grid_map, moved))
    tolerance = np.array([0.4, 0.4])
    values = np.array([31.0, -42.0])
    np.testing.assert_allclose(
        here.band(values, tolerance) + np.array([7.0, -3.0]), there.band(values, tolerance), atol=1e-9
    )


def test_no_contours_on_unmapped_ground_nor_in_a_constant_field(grid_map: GridMap) -> None:
    unmapped = replace(grid_map, support=np.full(grid_map.shape, 9.0, dtype=np.float32))
    flat = replace(grid_map, mean=np.full_like(grid_map.mean, 30.0))
    for one in (unmapped, flat):
        assert len(ContourMap.of(one, FeatureSet.HV).crossings(0, 30.0)) == 0
    assert len(ContourMap.of(unmapped, FeatureSet.HV).band(np.array([30.0, -40.0]), np.array([9.0, 9.0]))) == 0
