"""Replays over HTTP."""

from __future__ import annotations

import pytest

from app.api.schemas.replays import ReplayOut
from app.services import stored_segments
from app.services.records import Scope
from tests.api.harness import Api, as_msgpack, segment_body
from tests.api.test_versions import draft


def located(api: Api) -> tuple[str, str]:
    """A session with two segments, and a draft of its level."""
    level = api.mapped_level()
    session_id = str(api.ok("POST", "/v1/sessions", json={"level_id": level.id})["id"])
    for seq in range(2):
        assert api.post(f"/v1/sessions/{session_id}/segments", **as_msgpack(segment_body(seq))).is_success
    return session_id, draft(api, level)


def test_a_session_is_replayed_on_another_version(api: Api) -> None:
    session_id, map_id = located(api)
    before = api.stored()
    answer = api.ok("POST", f"/v1/sessions/{session_id}/replay", json={"map_id": map_id}, key=Scope.LOCATE)
    ReplayOut.model_validate(answer)
    session = api.ok("GET", f"/v1/sessions/{session_id}")
    assert (answer["map_id"], answer["maps_then"], answer["method"]) == (map_id, session["maps"], session["method"])
    told = api.ok("GET", f"/v1/sessions/{session_id}/positions")
    assert answer["fixes"] == told["fixes"]
    assert answer["comparison"]["distance"] == {"n": 6, "p50": 0.0, "p90": 0.0, "largest": 0.0}
    assert (answer["comparison"]["status_now"], answer["comparison"]["sure_now"]) == ({"ok": 1.0}, 1.0)
    assert api.stored() == before
    assert api.ok("POST", f"/v1/sessions/{session_id}/replay", json={})["maps"] == session["maps"]


def test_refusals_name_the_field(api: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    session_id, map_id = located(api)
    path, other = f"/v1/sessions/{session_id}/replay", api.mapped_level().current_map_id
    for body, field in (
        ({"map_id": other}, "map_id"),
        ({"map_ids": [map_id, other]}, "map_ids.1"),
        ({"map_ids": [map_id], "map_id": map_id}, "map_ids"),
        ({"map": map_id}, "map"),
    ):
        response = api.post(path, json=body)
        assert response.status_code == 422
        (error,) = response.json()["errors"]
        assert (error["field"], bool(error["remedy"])) == (field, True)
    assert api.post("/v1/sessions/ses_none/replay", json={}).status_code == 404
    monkeypatch.setattr(stored_segments, "MAX_SEGMENTS", 1)
    response = api.post(path, json={})
    assert response.status_code == 409
    assert response.json()["errors"][0]["field"] == "session_id"
