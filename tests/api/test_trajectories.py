from __future__ import annotations

import pytest

from app.api.schemas.trajectories import TrajectoryOut
from app.services import stored_segments
from app.services.records import Scope
from tests.api.harness import Api, plain, segment_body


def processed(api: Api, n: int = 2) -> str:
    session_id = api.session_id()
    for seq in range(n):
        api.ok("POST", f"/v1/sessions/{session_id}/segments", json=plain(segment_body(seq)))
    return session_id


def test_the_trajectory_of_a_session(api: Api) -> None:
    session_id = processed(api)
    before = api.stored()
    answer = api.ok("GET", f"/v1/sessions/{session_id}/trajectory", key=Scope.LOCATE)
    TrajectoryOut.model_validate(answer)
    session = api.ok("GET", f"/v1/sessions/{session_id}")
    assert (answer["session_id"], answer["map_id"]) == (session_id, session["map_id"])
    assert (answer["method"], answer["kind"]) == ("particle", "smoothed")
    fixes = api.ok("GET", f"/v1/sessions/{session_id}/positions")["fixes"]
    assert answer["fixes"].keys() == fixes.keys()
    assert {len(column) for column in answer["fixes"].values()} == {2}
    assert answer["fixes"]["kind"] == ["smoothed"] * 2
    assert api.ok("GET", f"/v1/sessions/{session_id}/trajectory") == answer
    assert api.stored() == before


def test_before_the_first_segment_it_is_empty(api: Api) -> None:
    answer = api.ok("GET", f"/v1/sessions/{api.session_id()}/trajectory")
    assert all(column == [] for column in answer["fixes"].values())


def test_a_method_without_a_smoother(api: Api) -> None:
    body = {"level_id": api.mapped_level().id, "method": "dead_reckoning"}
    session_id = api.ok("POST", "/v1/sessions", json=body)["id"]
    response = api.get(f"/v1/sessions/{session_id}/trajectory")
    assert (response.status_code, response.json()["type"].rpartition("/")[2]) == (409, "conflict")
    (error,) = response.json()["errors"]
    assert error["field"] == "method"
    assert "particle" in error["remedy"]


def test_a_session_too_long_for_it(api: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    session_id = processed(api)
    monkeypatch.setattr(stored_segments, "MAX_SEGMENTS", 1)
    response = api.get(f"/v1/sessions/{session_id}/trajectory")
    assert (response.status_code, response.json()["type"].rpartition("/")[2]) == (409, "conflict")
    (error,) = response.json()["errors"]
    assert error["field"] == "session_id"
    assert "new session" in error["remedy"]
