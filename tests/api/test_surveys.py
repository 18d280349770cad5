from __future__ import annotations

from app.services.records import Scope
from tests.api.harness import Api, as_msgpack, plain, walk_body


def survey_path(api: Api) -> str:
    level = api.level()
    created = api.ok("POST", "/v1/surveys", key=Scope.SURVEY, json={"level_id": level.id, "name": "spring"})
    return f"/v1/surveys/{created['id']}"


def test_create_and_list(api: Api) -> None:
    level = api.level()
    response = api.post("/v1/surveys", json={"level_id": level.id, "name": "spring"})
    assert response.status_code == 201
    survey = response.json()
    assert (survey["level_id"], survey["n_walks"]) == (level.id, 0)
    assert api.get(response.headers["Location"]).json() == survey
    assert api.ok("GET", f"/v1/surveys?level_id={level.id}")["items"] == [survey]
    assert api.ok("GET", f"/v1/surveys?level_id={api.level().id}")["items"] == []
    assert api.post("/v1/surveys", json={"level_id": "lvl_none", "name": "x"}).status_code == 404


def test_walks_are_stored_once(api: Api) -> None:
    path = survey_path(api)
    first = api.post(f"{path}/walks", key=Scope.SURVEY, json=plain(walk_body("there")))
    assert first.status_code == 201
    walk = first.json()
    assert (walk["n_samples"], walk["n_waypoints"], walk["length_m"]) == (500, 3, 7.0)
    assert api.get(first.headers["Location"]).json() == walk

    again = api.post(f"{path}/walks", **as_msgpack(walk_body("under another name")))
    assert (again.status_code, again.json()) == (200, walk)
    assert api.ok("GET", path)["n_walks"] == 1

    other = api.post(f"{path}/walks", json=plain(walk_body("back", seed=1)))
    assert other.status_code == 201
    assert [item["name"] for item in api.ok("GET", f"{path}/walks")["items"]] == ["there", "back"]


def test_a_walk_names_its_device(api: Api) -> None:
    path = survey_path(api)
    device_id = api.ok("POST", "/v1/devices", json={"name": "phone"})["id"]
    assert (
        api.ok("POST", f"{path}/walks", json={**plain(walk_body()), "device_id": device_id})["device_id"] == device_id
    )
    unknown = api.post(f"{path}/walks", json={**plain(walk_body(seed=1)), "device_id": "dev_none"})
    assert unknown.status_code == 404


def test_a_walk_belongs_to_its_survey(api: Api) -> None:
    path, other = survey_path(api), survey_path(api)
    walk_id = api.ok("POST", f"{path}/walks", json=plain(walk_body()))["id"]
    assert api.get(f"{other}/walks/{walk_id}").status_code == 404
    assert api.call("DELETE", f"{other}/walks/{walk_id}").status_code == 404
    assert api.call("DELETE", f"{path}/walks/{walk_id}").status_code == 204
    assert api.get(f"{path}/walks/{walk_id}").status_code == 404


def test_a_level_shows_where_it_was_walked(api: Api) -> None:
    path = survey_path(api)
    level_id = api.ok("GET", path)["level_id"]
    bodies = [plain(walk_body(f"walk {n}", seed=n)) for n in range(3)]
    walks = [api.ok("POST", f"{path}/walks", json=body)["id"] for body in bodies]
    tracks = f"/v1/levels/{level_id}/waypoints"
    first = api.ok("GET", f"{tracks}?limit=2", key=Scope.SURVEY)
    rest = api.ok("GET", f"{tracks}?limit=2&cursor={first['next_cursor']}")
    items = first["items"] + rest["items"]
    assert rest["next_cursor"] is None
    assert [(one["walk_id"], one["name"]) for one in items] == [(walk, f"walk {n}") for n, walk in enumerate(walks)]
    for body, one in zip(bodies, items, strict=True):
        assert (one["x"], one["y"]) == (body["waypoints"]["x"], body["waypoints"]["y"])
        assert one["t_ms"] == [round(t) for t in body["waypoints"]["t_ms"]]
    assert api.ok("GET", f"/v1/levels/{api.level().id}/waypoints")["items"] == []
    assert api.get("/v1/levels/lvl_none/waypoints").status_code == 404
