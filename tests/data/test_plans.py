"""Vector plans in level metres."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.evaluation.datasets.plans import plan_to_level_metres, positions, rings


def plan(x0: float, y0: float, dx: float, dy: float) -> dict[str, object]:
    def at(u: float, v: float) -> list[float]:
        return [x0 + u * dx, y0 + v * dy]

    outline = {"type": "MultiPolygon", "coordinates": [[[at(0, 0), at(1, 0), at(1, 1), at(0, 0)]]]}
    shop = {"type": "Polygon", "coordinates": [[at(0.25, 0.5), at(0.5, 0.5), at(0.5, 0.75), at(0.25, 0.5)]]}
    return {
        "type": "FeatureCollection",
        "features": [
            {"type": "Feature", "geometry": outline},
            {"type": "Feature", "geometry": shop, "properties": {"name": "shop", "point": [1.3e7, 3.5e6]}},
            {"type": "Feature", "geometry": None, "properties": {}},
        ],
    }


@given(st.floats(-179, 179), st.floats(-80, 80), st.floats(1e-3, 1e-2), st.floats(1e-3, 1e-2))
def test_the_bounding_box_becomes_the_plan_rectangle_wherever_it_lay(
    x0: float, y0: float, dx: float, dy: float
) -> None:
    result = plan_to_level_metres(plan(x0, y0, dx, dy), 200.0, 100.0)
    np.testing.assert_allclose(
        result["features"][0]["geometry"]["coordinates"][0][0], [[0, 0], [200, 0], [200, 100], [0, 0]], atol=2e-3
    )
    np.testing.assert_allclose(result["features"][1]["geometry"]["coordinates"][0][0], [50, 50], atol=2e-3)


def test_properties_are_reduced_and_features_without_geometry_dropped() -> None:
    result = plan_to_level_metres(plan(120.0, 30.0, 1e-3, 1e-3), 200.0, 100.0)
    assert [feature["properties"] for feature in result["features"]] == [
        {"role": "floor"},
        {"name": "shop", "role": "unit"},
    ]
    json.dumps(result, allow_nan=False)


def test_rings_and_positions_walk_the_nesting() -> None:
    result = plan_to_level_metres(plan(0.0, 0.0, 1.0, 1.0), 8.0, 4.0)
    assert [len(ring) for ring in rings(result)] == [4, 4]
    assert list(positions([[[1.0, 2.0]], [[3.0, 4.0]]])) == [[1.0, 2.0], [3.0, 4.0]]


@pytest.mark.parametrize("features", [[], [{"geometry": {"type": "Point", "coordinates": [1.0, 2.0]}}]])
def test_a_plan_without_area_is_refused(features: list[object]) -> None:
    with pytest.raises(ValueError, match=r"no coordinates|no area"):
        plan_to_level_metres({"features": features}, 1.0, 1.0)
