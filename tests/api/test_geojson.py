from __future__ import annotations

from dataclasses import replace

from app.api.geojson import feature_collection
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
