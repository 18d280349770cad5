"""Levels and venues are found by place and name over HTTP; a search that cannot be read is refused by its field."""

from __future__ import annotations

import pytest

from app.services.records import Anchor
from tests.api.harness import Api

EXTENT = (0.0, 0.0, 60.0, 40.0)


def house(api: Api, name: str, anchor: Anchor | None) -> tuple[str, str]:
    """Ids of a venue and its one level."""
    venue = api.services.venues.create(name, "indoor", anchor)  # type: ignore[arg-type]
    return venue.id, api.services.venues.create_level(venue.id, "F1", 0, EXTENT).id


@pytest.mark.parametrize("noun", ["venues", "levels"])
def test_found_by_place_name_and_page(api: Api, noun: str) -> None:
    k = ["venues", "levels"].index(noun)
    near, far = house(api, "Mall", Anchor(48.15, 11.57))[k], house(api, "Museum", Anchor(48.153, 11.57))[k]
    house(api, "Mall without a place", None)
    first = api.get(f"/v1/{noun}?near=48.15,11.57&radius_m=900&limit=1")
    body = first.json()
    assert [(one["id"], one["distance_m"]) for one in body["items"]] == [(near, 0.0)]
    assert "near=48.15%2C11.57&radius_m=900&limit=1" in first.headers["Link"]
    (second,) = api.ok("GET", f"/v1/{noun}?near=48.15,11.57&radius_m=900&limit=1&cursor={body['next_cursor']}")["items"]
    assert second["id"] == far
    assert second["distance_m"] == pytest.approx(333.6, abs=0.5)
    assert api.ok("GET", f"/v1/{noun}?near=48.15,11.57&radius_m=100")["items"][0]["id"] == near
    boxed = api.ok("GET", f"/v1/{noun}?bbox=11.5,48.152,11.6,48.2&q=mus")["items"]
    assert [(one["id"], one["distance_m"]) for one in boxed] == [(far, None)]
    assert len(api.ok("GET", f"/v1/{noun}?q=mall")["items"]) == 2


def test_levels_of_a_storey(api: Api) -> None:
    venue_id, _ = house(api, "Tower", None)
    upper = api.services.venues.create_level(venue_id, "F9", 8, EXTENT)
    assert [one["id"] for one in api.ok("GET", "/v1/levels?ordinal=8")["items"]] == [upper.id]


@pytest.mark.parametrize(
    ("query", "field"),
    [
        ("near=48.15", "near"),
        ("near=48.15,11.57,3", "near"),
        ("near=91,11", "near"),
        ("near=nan,11", "near"),
        ("near=a,b", "near"),
        ("near=1,2&radius_m=0", "radius_m"),
        ("near=1,2&radius_m=60000", "radius_m"),
        ("near=1,2&bbox=1,2,3,4", "bbox"),
        ("bbox=1,2,3", "bbox"),
        ("bbox=1,4,3,2", "bbox"),
        ("bbox=1,2,181,4", "bbox"),
        ("q=--", "q"),
        ("q=", "q"),
        ("near=1,2&cursor=lvl_1", "cursor"),
        ("near=" + "1" * 65, "near"),
    ],
)
@pytest.mark.parametrize("noun", ["venues", "levels"])
def test_what_cannot_be_read_is_refused(api: Api, noun: str, query: str, field: str) -> None:
    response = api.get(f"/v1/{noun}?{query}")
    assert response.status_code == 422
    (error,) = response.json()["errors"]
    assert error["field"].endswith(field)
    assert error["remedy"]
