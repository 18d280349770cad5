from __future__ import annotations

from app.services.records import Scope
from tests.api.harness import Api

ANCHOR = {"latitude_deg": 48.15, "longitude_deg": 11.57, "bearing_deg": 12.5, "height_m": 515.0}


def test_create_and_read(api: Api) -> None:
    response = api.post("/v1/venues", key=Scope.SURVEY, json={"name": "Mall", "kind": "route", "anchor": ANCHOR})
    assert response.status_code == 201
    venue = response.json()
    assert venue["name"] == "Mall"
    assert venue["kind"] == "route"
    assert venue["anchor"] == ANCHOR
    assert venue["created_at"].endswith("Z")
    assert api.get(response.headers["Location"], key=Scope.LOCATE).json() == venue


def test_defaults(api: Api) -> None:
    venue = api.ok("POST", "/v1/venues", json={"name": "Mall"})
    assert (venue["kind"], venue["anchor"]) == ("indoor", None)


def test_patch_changes_what_is_sent_only(api: Api) -> None:
    path = f"/v1/venues/{api.ok('POST', '/v1/venues', json={'name': 'Mall', 'anchor': ANCHOR})['id']}"
    assert api.ok("PATCH", path, json={"name": "East"})["anchor"] == ANCHOR
    moved = api.ok("PATCH", path, json={"anchor": {"latitude_deg": 1.0, "longitude_deg": 2.0}})
    assert moved["name"] == "East"
    assert moved["anchor"] == {"latitude_deg": 1.0, "longitude_deg": 2.0, "bearing_deg": 0.0, "height_m": 0.0}
    assert api.ok("PATCH", path, json={"anchor": None})["anchor"] is None
    assert api.ok("GET", path)["name"] == "East"


def test_delete_only_when_empty(api: Api) -> None:
    level = api.level()
    refused = api.call("DELETE", f"/v1/venues/{level.venue_id}")
    assert refused.status_code == 409
    assert "levels" in refused.json()["detail"]
    empty = api.ok("POST", "/v1/venues", json={"name": "Empty"})["id"]
    assert api.call("DELETE", f"/v1/venues/{empty}").status_code == 204
    assert api.get(f"/v1/venues/{empty}").status_code == 404
