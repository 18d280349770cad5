"""Geofences and their events over HTTP."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from typing import Any

import pytest

from app.api.geofence_csv import _cell
from app.engine.types import Fix
from app.services.records import JobKind, Scope
from tests.api.harness import Api, plain, segment_body
from tests.support.builders import fix, locate_result

ROOM = [[10, 10], [20, 10], [20, 20], [10, 20]]
T0 = 1_790_000_000.0
IN, OUT = (15.0, 15.0), (40.0, 15.0)


def create(api: Api, level_id: str, **changes: Any) -> Any:
    return api.ok("POST", "/v1/geofences", json={"name": "room", "level_id": level_id, "polygon": ROOM, **changes})


def visit(api: Api, session_id: str, level_id: str, seq: int, *places: tuple[float, float]) -> None:
    """A segment whose fixes are at these places, a second apart."""
    api.worker.idle = True
    api.ok("POST", f"/v1/sessions/{session_id}/segments", json=plain(segment_body(seq)))
    (job,) = api.services.processing.claim(1, JobKind.LOCATE_SEGMENT)
    fixes: Sequence[Fix] = [fix(T0 + 5 * seq + i, level_id=level_id, x=x, y=y) for i, (x, y) in enumerate(places)]
    api.services.processing.complete_locate(job, replace(locate_result(seq), fixes=tuple(fixes)))


@pytest.fixture
def visited(api: Api) -> tuple[Api, str, str]:
    """An API with a geofence ``=room`` that a session entered, left, entered, and left by closing."""
    level = api.mapped_level()
    create(api, level.id, name="=room", events=["enter", "leave", "dwell"], dwell_s=5)
    session_id = api.ok("POST", "/v1/sessions", json={"level_id": level.id})["id"]
    visit(api, session_id, level.id, 0, IN, OUT, IN)
    visit(api, session_id, level.id, 1, IN, IN, IN, IN)
    api.ok("POST", f"/v1/sessions/{session_id}/close")
    return api, level.id, session_id


def test_a_geofence_is_made_read_changed_and_deleted(api: Api) -> None:
    level = api.level()
    response = api.post(
        "/v1/geofences",
        key=Scope.SURVEY,
        json={"name": "room", "level_id": level.id, "polygon": [*ROOM, ROOM[0]][::-1]},
    )
    made = response.json()
    assert response.status_code == 201
    assert response.headers["Location"] == f"/v1/geofences/{made['id']}"
    assert made["polygon"] in [[*ROOM[i:], *ROOM[:i]] for i in range(4)], "counter-clockwise and open"
    assert (made["events"], made["dwell_s"], made["confidence"]) == (["enter", "leave"], None, 0.9)
    path = f"/v1/geofences/{made['id']}"
    assert api.ok("GET", path, key=Scope.LOCATE) == made
    assert api.ok("GET", f"/v1/geofences?level_id={level.id}")["items"] == [made]
    dwelling = api.ok("PATCH", path, json={"events": ["dwell"], "dwell_s": 60, "name": "other"})
    assert (dwelling["events"], dwelling["dwell_s"], dwelling["name"]) == (["dwell"], 60.0, "other")
    plainer = api.ok("PATCH", path, json={"events": ["enter"], "confidence": 0.95})
    assert (plainer["dwell_s"], plainer["confidence"], plainer["polygon"]) == (None, 0.95, made["polygon"])
    assert api.call("DELETE", path).status_code == 204
    assert api.get(path).status_code == 404


def test_a_creation_may_be_repeated(api: Api) -> None:
    level = api.level()
    body = {"name": "room", "level_id": level.id, "polygon": ROOM}
    first, second = (api.post("/v1/geofences", json=body, headers={"Idempotency-Key": "k"}) for _ in range(2))
    assert first.json() == second.json()
    assert second.headers["Idempotency-Replayed"] == "true"


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"polygon": [[0, 0], [9, 9], [9, 0], [0, 9]]}, "polygon"),
        ({"polygon": [[0, 0], [900, 0], [9, 9]]}, "polygon"),
        ({"polygon": [[0, 0], [9, 0], [9]]}, "polygon.2"),
        ({"polygon": [[0, 0], [9, 0], [9, "9"]]}, "polygon.2.1"),
        ({"polygon": [[0, i] for i in range(202)]}, "polygon"),
        ({"confidence": 0.5}, "confidence"),
        ({"events": []}, "events"),
        ({"events": ["fly"]}, "events.0"),
        ({"events": ["dwell"]}, "dwell_s"),
        ({"dwell_s": 5}, "dwell_s"),
        ({"events": ["dwell"], "dwell_s": 0}, "dwell_s"),
        ({"colour": "red"}, "colour"),
        ({"name": " "}, "name"),
    ],
)
def test_refusals_name_the_field_and_the_remedy(api: Api, changes: dict[str, Any], field: str) -> None:
    body = {"name": "room", "level_id": api.level().id, "polygon": ROOM, **changes}
    response = api.post("/v1/geofences", json=body)
    assert response.status_code == 422, response.text
    (error,) = response.json()["errors"]
    assert error["field"] == field
    assert error["remedy"]


def test_an_unknown_level_is_not_found(api: Api) -> None:
    body = {"name": "room", "level_id": "lvl_0", "polygon": ROOM}
    assert api.post("/v1/geofences", json=body).status_code == 404
    assert api.get("/v1/geofences?level_id=lvl_0").status_code == 404


def test_events_are_listed_and_filtered(visited: tuple[Api, str, str]) -> None:
    api, level_id, session_id = visited

    def kinds(query: str = "") -> list[str]:
        items = api.ok("GET", f"/v1/geofence-events{query}", key=Scope.LOCATE)["items"]
        return [item["kind"] for item in reversed(items)]

    assert kinds() == kinds(f"?session_id={session_id}&level_id={level_id}")
    assert kinds() == ["enter", "leave", "enter", "dwell", "leave"]
    assert kinds("?kind=leave") == ["leave", "leave"]
    assert kinds("?geofence_id=gfc_0") == []
    assert kinds("?before=2026-09-21T13:46:42") == kinds("?before=2026-09-21T13:46:42Z")
    last = api.ok("GET", "/v1/geofence-events?limit=1")["items"][0]
    assert (last["reason"], last["probability"], last["x"]) == ("session closed", None, 15.0)
    first = api.ok("GET", "/v1/geofence-events?kind=enter")["items"][-1]
    assert (first["t_ms"], first["seq"], first["session_id"]) == (T0 * 1000, 0, session_id)


def test_times_are_those_of_the_fixes(visited: tuple[Api, str, str]) -> None:
    api = visited[0]
    middle = (datetime.fromtimestamp(T0, UTC) + timedelta(seconds=1.5)).isoformat().replace("+00:00", "Z")
    early = api.ok("GET", f"/v1/geofence-events?before={middle}")["items"]
    late = api.ok("GET", f"/v1/geofence-events?after={middle}")["items"]
    assert (len(early), len(late)) == (2, 3)
    response = api.get("/v1/geofence-events?after=yesterday")
    assert (response.status_code, response.json()["errors"][0]["field"]) == (422, "after")


def test_pages_lead_on(visited: tuple[Api, str, str]) -> None:
    api = visited[0]
    path, seen = "/v1/geofence-events?limit=2", []
    while path:
        response = api.get(path)
        seen += response.json()["items"]
        path = response.headers["Link"].split(">")[0][1:] if "Link" in response.headers else ""
    assert seen == api.ok("GET", "/v1/geofence-events")["items"]


def test_events_as_a_table(visited: tuple[Api, str, str]) -> None:
    api = visited[0]
    response = api.get("/v1/geofence-events?limit=3", headers={"Accept": "text/csv"})
    assert response.headers["Content-Type"].startswith("text/csv")
    assert 'rel="next"' in response.headers["Link"]
    rows = list(csv.DictReader(io.StringIO(response.text)))
    items = api.ok("GET", "/v1/geofence-events?limit=3")["items"]
    assert [row["id"] for row in rows] == [item["id"] for item in items]
    assert list(rows[0]) == list(items[0])
    assert {row["geofence_name"] for row in rows} == {"'=room"}, "no formula for a spreadsheet"
    assert (rows[0]["probability"], rows[0]["reason"]) == ("", "session closed")
    both = api.get("/v1/geofence-events", headers={"Accept": "application/json, text/csv;q=0.5"})
    assert both.headers["Content-Type"] == "application/json"


@pytest.mark.parametrize("start", ["=", "+", "-", "@", "\t", "\r"])
def test_no_cell_is_a_formula(start: str) -> None:
    assert _cell(f"{start}1") == f"'{start}1"
    assert (_cell(-1.5), _cell(None), _cell("a")) == (-1.5, "", "a")
