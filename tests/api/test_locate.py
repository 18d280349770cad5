from __future__ import annotations

from app.api.schemas.locate import LocateOut
from app.services.records import Scope
from tests.api.harness import Api, as_msgpack, plain, segment_body


def test_one_call(api: Api) -> None:
    level = api.mapped_level()
    body = {"level_id": level.id, "prior": {"x": 1.0, "y": 2.0}, "samples": segment_body()["samples"]}
    before = api.stored()
    answer = api.ok("POST", "/v1/locate", key=Scope.LOCATE, json=plain(body))
    LocateOut.model_validate(answer)
    assert (answer["map_id"], answer["method"]) == (level.current_map_id, "particle")
    assert answer["maps"] == [{"level_id": level.id, "map_id": level.current_map_id}]
    assert len(answer["fixes"]["x"]) == 3
    assert answer["fixed_lag"].keys() == answer["fixes"].keys()
    assert api.ok("POST", "/v1/locate", **as_msgpack(body)) == answer
    assert api.stored() == before


def test_any_level_of_a_venue(api: Api) -> None:
    venue_id, levels = api.mapped_venue()
    body = plain({"venue_id": venue_id, "samples": segment_body()["samples"]})
    answer = api.ok("POST", "/v1/locate", key=Scope.LOCATE, json=body)
    LocateOut.model_validate(answer)
    assert answer["map_id"] is None
    assert answer["maps"] == [{"level_id": level.id, "map_id": level.current_map_id} for level in levels]
    assert answer["position"]["level_id"] == levels[0].id


def test_a_level_without_a_map(api: Api) -> None:
    body = {"level_id": api.level().id, "samples": segment_body()["samples"]}
    assert api.post("/v1/locate", json=plain(body)).json()["type"].endswith("/no-map")


def test_bad_samples_are_refused_before_any_work(api: Api) -> None:
    body = plain({"level_id": "lvl_none", "samples": segment_body()["samples"]})
    body["samples"]["gyro"]["z"].pop()
    (error,) = api.post("/v1/locate", json=body).json()["errors"]
    assert error["field"] == "samples.gyro.z"
