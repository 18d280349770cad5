from __future__ import annotations

import io

import orjson
import pytest
from PIL import Image

from app.services.records import Scope
from tests.api.harness import Api

EXTENT = {"x_min": -3.5, "y_min": 2.0, "x_max": 60.0, "y_max": 40.5}
PLAN = {
    "type": "FeatureCollection",
    "features": [
        {
            "type": "Feature",
            "properties": {"name": "Straße"},
            "geometry": {"type": "Polygon", "coordinates": [[[0, 0], [9.5, 0], [9.5, 4], [0, 0]]]},
        },
        {"type": "Feature", "properties": None, "geometry": None},
    ],
}


def png(size: tuple[int, int] = (4, 3)) -> bytes:
    buffer = io.BytesIO()
    Image.new("RGB", size).save(buffer, "PNG")
    return buffer.getvalue()


def test_create_and_read(api: Api) -> None:
    venue_id = api.ok("POST", "/v1/venues", json={"name": "Mall"})["id"]
    response = api.post(
        f"/v1/venues/{venue_id}/levels", key=Scope.SURVEY, json={"name": "F2", "ordinal": 1, "extent": EXTENT}
    )
    assert response.status_code == 201
    level = response.json()
    assert level["extent"] == EXTENT
    assert (level["venue_id"], level["ordinal"], level["current_map_id"]) == (venue_id, 1, None)
    assert not level["has_plan_image"]
    assert api.get(response.headers["Location"]).json() == level


def test_list_of_one_venue(api: Api) -> None:
    first, second = api.level(), api.level()
    listed = api.ok("GET", "/v1/levels")["items"]
    assert [level["id"] for level in listed] == [second.id, first.id]
    assert [level["id"] for level in api.ok("GET", f"/v1/levels?venue_id={first.venue_id}")["items"]] == [first.id]
    assert api.get("/v1/levels?venue_id=ven_none").status_code == 404


@pytest.mark.parametrize(
    ("name", "kind", "content"),
    [("plan.png", "image/png", png()), ("plan.geojson", "application/geo+json", orjson.dumps(PLAN))],
)
def test_plans_come_back_with_their_tag(api: Api, name: str, kind: str, content: bytes) -> None:
    path = f"/v1/levels/{api.level().id}/{name}"
    assert api.get(path).status_code == 404
    assert api.call("PUT", path, content=content, headers={"Content-Type": kind}).status_code == 204
    response = api.get(path)
    assert response.headers["Content-Type"] == kind
    assert response.content == content
    tag = response.headers["ETag"]
    unchanged = api.get(path, headers={"If-None-Match": f'"other", W/{tag}'})
    assert (unchanged.status_code, unchanged.content, unchanged.headers["ETag"]) == (304, b"", tag)
    assert api.get(path, headers={"If-None-Match": '"other"'}).status_code == 200


def test_a_level_says_which_plans_it_has(api: Api) -> None:
    level_id = api.level().id
    api.call("PUT", f"/v1/levels/{level_id}/plan.png", content=png(), headers={"Content-Type": "image/png"})
    level = api.ok("GET", f"/v1/levels/{level_id}")
    assert (level["has_plan_image"], level["has_vector_plan"]) == (True, False)


@pytest.mark.parametrize("content", [b"", b"not an image", png()[:40], b"GIF89a" + png()])
def test_what_is_no_png_is_refused(api: Api, content: bytes) -> None:
    level_id = api.level().id
    path = f"/v1/levels/{level_id}/plan.png"
    response = api.call("PUT", path, content=content, headers={"Content-Type": "image/png"})
    assert response.status_code == 422
    assert response.json()["errors"][0]["remedy"] == "send a complete PNG"
    assert api.get(path).status_code == 404


@pytest.mark.parametrize(
    ("plan", "field"),
    [
        ([], "type"),
        ({"type": "Feature"}, "type"),
        ({"type": "FeatureCollection"}, "features"),
        ({"type": "FeatureCollection", "features": [{"type": "Point"}]}, "features.0"),
        (
            {"type": "FeatureCollection", "features": [{"type": "Feature", "geometry": {"type": "Circle"}}]},
            "features.0.geometry",
        ),
        (
            {
                "type": "FeatureCollection",
                "features": [{"type": "Feature", "geometry": {"type": "Point", "coordinates": [1, "2"]}}],
            },
            "features.0.geometry.coordinates",
        ),
    ],
)
def test_what_is_no_plan_is_refused(api: Api, plan: object, field: str) -> None:
    path = f"/v1/levels/{api.level().id}/plan.geojson"
    response = api.call("PUT", path, json=plan)
    assert response.status_code == 422
    assert response.json()["errors"][0]["field"] == field
    assert api.get(path).status_code == 404


def test_a_deeply_nested_plan_is_checked_without_recursion(api: Api) -> None:
    depth = 300
    geometry = b'{"type":"GeometryCollection","geometries":[' * depth + b"]}" * depth
    body = b'{"type":"FeatureCollection","features":[{"type":"Feature","geometry":' + geometry + b"}]}"
    path = f"/v1/levels/{api.level().id}/plan.geojson"
    assert api.call("PUT", path, content=body, headers={"Content-Type": "application/geo+json"}).status_code == 204


def test_plans_of_another_type_are_refused(api: Api) -> None:
    path = f"/v1/levels/{api.level().id}/plan.png"
    response = api.call("PUT", path, content=png(), headers={"Content-Type": "image/jpeg"})
    assert response.status_code == 415
    assert response.headers["Accept"] == "image/png"


def test_a_level_is_changed(api: Api) -> None:
    venue_id = api.ok("POST", "/v1/venues", json={"name": "Mall", "anchor": {"latitude_deg": 48, "longitude_deg": 11}})[
        "id"
    ]
    level = api.ok("POST", f"/v1/venues/{venue_id}/levels", json={"name": "F2", "extent": EXTENT})
    path = f"/v1/levels/{level['id']}"
    renamed = api.ok("PATCH", path, key=Scope.SURVEY, json={"name": "Mezzanine", "ordinal": 2})
    assert renamed == {**level, "name": "Mezzanine", "ordinal": 2, "updated_at": renamed["updated_at"]}
    assert api.ok("GET", path) == renamed
    assert [one["id"] for one in api.ok("GET", "/v1/levels?q=mezz mall")["items"]] == [level["id"]]
    assert api.ok("GET", "/v1/levels?q=F2")["items"] == []
    # a kilometre to the north: not in the venue until the level reaches so far
    beyond = "near=48.009,11&radius_m=10"
    assert api.ok("GET", f"/v1/venues?{beyond}")["items"] == []
    wide = {"x_min": -5, "y_min": 0, "x_max": 20, "y_max": 1100}
    assert api.ok("PATCH", path, json={"extent": wide})["extent"] == wide
    assert [one["id"] for one in api.ok("GET", f"/v1/levels?{beyond}")["items"]] == [level["id"]]
    assert [one["id"] for one in api.ok("GET", f"/v1/venues?{beyond}")["items"]] == [venue_id]
    assert api.ok("PATCH", path, json={"extent": EXTENT})["extent"] == level["extent"]
    assert api.ok("GET", f"/v1/venues?{beyond}")["items"] == []


def test_a_level_is_not_made_nonsense(api: Api) -> None:
    path = f"/v1/levels/{api.level().id}"
    before = api.ok("GET", path)
    for body in (
        {"name": ""},
        {"ordinal": 1.5},
        {"extent": {**EXTENT, "x_max": -100}},
        {"extent": {"x_min": 0}},
        {"x": 1},
    ):
        assert api.call("PATCH", path, json=body).status_code == 422, body
    assert api.call("PATCH", "/v1/levels/lvl_none", json={"name": "x"}).status_code == 404
    assert api.ok("GET", path) == before
