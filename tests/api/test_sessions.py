from __future__ import annotations

import pytest

from app.services.records import Scope
from tests.api.harness import Api, plain, segment_body


def test_open_read_list_close(api: Api) -> None:
    level = api.mapped_level()
    device_id = api.ok("POST", "/v1/devices", json={"name": "phone"})["id"]
    body = {
        "level_id": level.id,
        "method": "particle",
        "parameters": {"particles": 500},
        "prior": {"x": 1.5, "y": 2.5, "radius_m": 2.0, "heading_deg": 90.0, "heading_sd_deg": 10.0},
        "device_id": device_id,
    }
    response = api.post("/v1/sessions", key=Scope.LOCATE, json=body)
    assert response.status_code == 201
    session = response.json()
    assert {name: session[name] for name in body} == body
    assert (session["map_id"], session["venue_id"]) == (level.current_map_id, level.venue_id)
    assert session["maps"] == [{"level_id": level.id, "map_id": level.current_map_id}]
    assert (session["status"], session["next_seq"], session["closed_at"]) == ("open", 0, None)
    path = response.headers["Location"]
    assert api.get(path).json() == session

    other = api.ok("POST", "/v1/sessions", json={"level_id": level.id})
    closed = api.ok("POST", f"{path}/close", key=Scope.LOCATE)
    assert closed["status"] == "closed"
    assert api.ok("POST", f"{path}/close") == closed
    for query, expected in (
        ("", [other["id"], session["id"]]),
        ("?status=open", [other["id"]]),
        ("?status=closed", [session["id"]]),
        (f"?device_id={device_id}", [session["id"]]),
        (f"?level_id={level.id}&status=open", [other["id"]]),
    ):
        assert [item["id"] for item in api.ok("GET", f"/v1/sessions{query}")["items"]] == expected, query


def test_defaults(api: Api) -> None:
    session = api.ok("POST", "/v1/sessions", json={"level_id": api.mapped_level().id})
    assert (session["method"], session["parameters"], session["device_id"]) == ("particle", {}, None)
    prior = session["prior"]
    assert [prior[name] for name in ("x", "y", "heading_deg", "heading_sd_deg")] == [None] * 4


def test_a_map_version_can_be_pinned(api: Api) -> None:
    level = api.mapped_level()
    first = level.current_map_id
    api.ok("POST", "/v1/maps", json={"level_id": level.id}, headers={"Prefer": "wait=5"})
    assert api.ok("POST", "/v1/sessions", json={"level_id": level.id, "map_id": first})["map_id"] == first
    assert api.ok("POST", "/v1/sessions", json={"level_id": level.id})["map_id"] != first
    foreign = api.post("/v1/sessions", json={"level_id": api.level().id, "map_id": first})
    assert foreign.json()["errors"][0]["field"] == "map_id"


def test_any_level_of_a_venue(api: Api) -> None:
    venue_id, levels = api.mapped_venue()
    body = {"venue_id": venue_id, "prior": {"heading_deg": 90.0}}
    session = api.ok("POST", "/v1/sessions", key=Scope.LOCATE, json=body)
    assert (session["venue_id"], session["level_id"], session["map_id"]) == (venue_id, None, None)
    assert session["maps"] == [{"level_id": level.id, "map_id": level.current_map_id} for level in levels]
    assert api.ok("GET", f"/v1/sessions/{session['id']}") == session
    api.session_id()
    assert [one["id"] for one in api.ok("GET", f"/v1/sessions?venue_id={venue_id}")["items"]] == [session["id"]]
    path = f"/v1/sessions/{session['id']}"
    sent = api.ok("POST", f"{path}/segments", json=plain(segment_body(0)), headers={"Prefer": "wait=5"})
    assert sent["fixes"]["level_id"] == [levels[0].id] * 3
    trajectory = api.ok("GET", f"{path}/trajectory")
    assert (trajectory["map_id"], trajectory["maps"]) == (None, session["maps"])


@pytest.mark.parametrize(
    ("body", "field"),
    [
        ({}, "level_id"),
        ({"venue_id": None}, "level_id"),
        ({"venue_id": "VENUE", "level_id": "LEVEL"}, "venue_id"),
        ({"venue_id": "VENUE", "map_id": "MAP"}, "map_id"),
        ({"venue_id": "VENUE", "prior": {"x": 1.0, "y": 2.0}}, "prior.x"),
    ],
)
@pytest.mark.parametrize("path", ["/v1/sessions", "/v1/locate"])
def test_a_place_is_a_level_or_a_venue(api: Api, path: str, body: dict[str, object], field: str) -> None:
    level = api.mapped_level()
    ids = {"VENUE": level.venue_id, "LEVEL": level.id, "MAP": level.current_map_id}
    named = {name: ids.get(str(value), value) for name, value in body.items()}
    samples = {"samples": segment_body()["samples"]} if path == "/v1/locate" else {}
    response = api.post(path, json=plain({**named, **samples}))
    assert response.status_code == 422
    (error,) = response.json()["errors"]
    assert error["field"] == field
    assert "level_id" in error["remedy"] or "one of the two" in error["remedy"]
    assert api.stored()["sessions"] == 0


def test_a_venue_without_a_map(api: Api) -> None:
    response = api.post("/v1/sessions", json={"venue_id": api.level().venue_id})
    assert response.status_code == 409
    (error,) = response.json()["errors"]
    assert (error["field"], response.json()["type"]) == ("venue_id", "https://isodyn.dev/problems/no-map")
    assert "POST /v1/maps" in error["remedy"]
    assert api.post("/v1/sessions", json={"venue_id": "ven_none"}).status_code == 404


def test_a_level_without_a_map(api: Api) -> None:
    response = api.post("/v1/sessions", json={"level_id": api.level().id})
    assert response.status_code == 409
    problem = response.json()
    assert problem["type"] == "https://isodyn.dev/problems/no-map"
    assert "POST /v1/maps" in problem["detail"]
    assert api.stored()["sessions"] == 0


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"method": "magic"}, "method"),
        ({"parameters": {"wands": 1}}, "parameters.wands"),
        ({"parameters": {"particles": "many"}}, "parameters.particles"),
        ({"parameters": {"particles": 1}}, "parameters.particles"),
        ({"parameters": {"particles": [1]}}, "parameters.particles"),
        ({"parameters": {"particles": None}}, "parameters.particles"),
        ({"prior": {"x": 1.0}}, "prior"),
        ({"prior": {"x": "1", "y": 2}}, "prior.x"),
        ({"prior": {"radius_m": 0}}, "prior.radius_m"),
        ({"prior": {"heading": 1}}, "prior.heading"),
        ({"level": "x"}, "level"),
        ({"device_id": ""}, "device_id"),
        ({"calibration_epoch": "a"}, "calibration_epoch"),
        ({"calibration_epoch": "x" * 65}, "calibration_epoch"),
        ({"calibration_epoch": "a\nb"}, "calibration_epoch"),
        ({"calibration_epoch": None}, "calibration_epoch"),
        ({"calibration_epoch": 5}, "calibration_epoch"),
    ],
)
def test_what_cannot_be_accepted_is_named(api: Api, change: dict[str, object], field: str) -> None:
    before = api.mapped_level()
    response = api.post("/v1/sessions", json={"level_id": before.id, **change})
    assert response.status_code == 422
    (error,) = response.json()["errors"]
    assert error["field"] == field
    assert error["remedy"]
    assert api.stored()["sessions"] == 0
