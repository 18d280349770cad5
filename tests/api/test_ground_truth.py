from __future__ import annotations

import json
import math
from typing import Any

import pytest

from app.services.records import VenueKind
from tests.api.harness import Api, plain, segment_body
from tests.support.builders import T0, new_walk

PATH = "/v1/sessions/{}/ground-truth"


def point(seconds: float, x: float = 3.0, y: float = 4.0, **more: Any) -> dict[str, Any]:
    return {"t_ms": (T0 + seconds) * 1000, "x": x, "y": y, **more}


def wide_session(api: Api) -> str:
    """A session on a level that reaches as far as the fixes of the tests' locate task, which lie anywhere in 1 km."""
    venue = api.services.venues.create("Hall", VenueKind.INDOOR, None)
    level = api.services.venues.create_level(venue.id, "1", 0, (-50.0, -50.0, 1050.0, 50.0))
    survey = api.services.surveys.create(level.id, "survey")
    api.services.surveys.add_walk(survey.id, new_walk())
    api.ok("POST", "/v1/maps", json={"level_id": level.id}, headers={"Prefer": "wait=5"})
    return str(api.ok("POST", "/v1/sessions", json={"level_id": level.id})["id"])


def send(api: Api, session_id: str, seq: int = 0) -> None:
    api.ok("POST", f"/v1/sessions/{session_id}/segments", json=plain(segment_body(seq)))


def body_of(*points: dict[str, Any]) -> dict[str, Any]:
    return {name: [one[name] for one in points] for name in points[0]}


def add(api: Api, session_id: str, *points: dict[str, Any]) -> list[dict[str, Any]]:
    made = api.ok("POST", PATH.format(session_id), json=body_of(*points))
    return list(made["items"])


def test_points_that_come_after_the_fixes_are_matched_at_once(api: Api) -> None:
    session_id = wide_session(api)
    send(api, session_id)
    (fix,) = [api.ok("GET", f"/v1/sessions/{session_id}/positions")["fixes"]]
    (found,) = add(api, session_id, point(0.0, fix["x"][0] + 3.0, fix["y"][0] + 4.0))
    assert found["fix"]["error_m"] == pytest.approx(5.0)
    assert (found["fix"]["inside"], found["fix"]["sure"], found["fix"]["status"]) == (False, True, "ok")
    assert found["fix"]["level_id"] == fix["level_id"][0]


def test_points_that_come_first_are_matched_with_the_fixes(api: Api) -> None:
    session_id = api.session_id()
    (early,) = add(api, session_id, point(0.0))
    assert (early["fix"], early["settled"]) == (None, False)
    send(api, session_id)
    (told,) = api.ok("GET", PATH.format(session_id))["items"]
    assert told["fix"] is not None
    assert not told["settled"]  # fixes reach 40 ms: a later one may still come nearer
    send(api, session_id, 1)
    (done,) = api.ok("GET", PATH.format(session_id))["items"]
    assert done == {**told, "settled": True}


def test_a_place_that_no_fix_is_near_stays_unmatched(api: Api) -> None:
    session_id = api.session_id()
    send(api, session_id)
    send(api, session_id, 1)
    (found,) = add(api, session_id, point(2.5))
    assert (found["fix"], found["settled"]) == (None, True)
    assert api.ok("GET", "/v1/stats/accuracy", params=SPAN)["items"] == []


SPAN = {"since": "2026-09-01T00:00:00Z", "until": "2026-10-01T00:00:00Z"}


def test_the_error_budget(api: Api) -> None:
    session_id = wide_session(api)
    send(api, session_id)
    x, y = (api.ok("GET", f"/v1/sessions/{session_id}/positions")["fixes"][name][0] for name in "xy")
    add(api, session_id, point(0.0, x, y), point(0.02, x + 30.0, y), point(0.04, x, y + 0.5))
    rows = api.ok("GET", "/v1/stats/accuracy", params={**SPAN, "by": "level"})["items"]
    assert [row["fixes"] for row in rows] == ["all", "sure"]
    whole = rows[0]
    assert (whole["n"], whole["p50_m"]) == (3, pytest.approx(0.5))
    assert whole["inside_share"] == pytest.approx(2 / 3)
    assert 0.2 < whole["inside_low"] < 2 / 3 < whole["inside_high"] < 0.95
    assert whole["level_id"].startswith("lvl_")
    outside = {**SPAN, "until": "2026-09-02T00:00:00Z"}
    assert api.ok("GET", "/v1/stats/accuracy", params=outside)["items"] == []


def test_a_point_of_the_same_time_takes_the_place_of_the_first(api: Api) -> None:
    session_id = api.session_id()
    add(api, session_id, point(0.0, 1.0, 1.0), point(1.0, 2.0, 2.0))
    add(api, session_id, point(0.0, 9.0, 9.0), point(3.0, 7.0, 7.0), point(3.0, 8.0, 8.0))
    items = api.ok("GET", PATH.format(session_id))["items"]
    assert [(item["t_ms"] - T0 * 1000, item["x"]) for item in items] == [(1000, 2.0), (0, 9.0), (3000, 8.0)]


def test_points_of_another_level_miss(api: Api) -> None:
    venue_id, levels = api.mapped_venue()
    session_id = api.ok("POST", "/v1/sessions", json={"venue_id": venue_id})["id"]
    send(api, session_id)
    fix = api.ok("GET", f"/v1/sessions/{session_id}/positions")["fixes"]
    for level in levels:
        (found,) = add(api, session_id, point(0.0, 1.0, fix["y"][0], level_id=level.id, sd_m=100.0))
        near = abs(fix["x"][0] - 1.0) < 200
        assert found["fix"]["inside"] == (near and level.id == fix["level_id"][0])


def test_pages_and_forgetting(api: Api) -> None:
    session_id = api.session_id()
    add(api, session_id, *(point(seconds) for seconds in range(5)))
    path = PATH.format(session_id)
    first = api.get(path, params={"limit": 3})
    assert 'rel="next"' in first.headers["Link"]
    rest = api.ok("GET", path, params={"limit": 3, "cursor": first.json()["next_cursor"]})
    assert [item["number"] for item in first.json()["items"] + rest["items"]] == [0, 1, 2, 3, 4]
    assert api.call("DELETE", path).status_code == 204
    assert api.ok("GET", path)["items"] == []


@pytest.mark.parametrize(
    ("wrong", "field"),
    [
        ({"t_ms": [], "x": [], "y": []}, "t_ms"),
        (body_of(point(0.0, x=1e5)), "x.0"),
        (body_of(point(0.0), point(1.0, y=-200.0)), "y.1"),
        ({**body_of(point(0.0)), "t_ms": [1_790_000_000]}, "t_ms.0"),
        ({**body_of(point(0.0)), "t_ms": [math.nan]}, "t_ms.0"),
        (body_of(point(0.0, sd_m=-1.0)), "sd_m.0"),
        (body_of(point(0.0, name="door")), "name"),
        ({**body_of(point(0.0)), "x": [1.0, 2.0]}, "x"),
        (body_of(*[point(0.0)] * 501), "t_ms"),
    ],
)
def test_what_cannot_be_true_is_refused(api: Api, wrong: dict[str, Any], field: str) -> None:
    session_id = api.session_id()
    response = api.post(
        PATH.format(session_id), content=json.dumps(wrong), headers={"Content-Type": "application/json"}
    )
    assert response.status_code == 422, response.text
    assert response.json()["errors"][0]["field"] == field
    assert api.ok("GET", PATH.format(session_id))["items"] == []


def test_a_level_elsewhere_and_a_session_that_is_none(api: Api) -> None:
    session_id = api.session_id()
    response = api.post(PATH.format(session_id), json=body_of(point(0.0, level_id=api.level().id)))
    assert response.status_code == 422
    assert response.json()["errors"][0]["field"] == "level_id.0"
    for method in ("GET", "DELETE"):
        assert api.call(method, PATH.format("ses_0")).status_code == 404
    assert api.post(PATH.format("ses_0"), json=body_of(point(0.0))).status_code == 404
