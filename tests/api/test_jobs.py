from __future__ import annotations

from app.services.records import Scope
from tests.api.harness import Api, plain, segment_body


def test_list_read_cancel(api: Api) -> None:
    api.worker.idle = True
    level = api.surveyed_level()
    first, second = (api.ok("POST", "/v1/maps", json={"level_id": level.id})["id"] for _ in range(2))
    assert [job["id"] for job in api.ok("GET", "/v1/jobs", key=Scope.SURVEY)["items"]] == [second, first]
    assert api.ok("GET", "/v1/jobs?kind=locate_segment")["items"] == []

    cancelled = api.ok("POST", f"/v1/jobs/{first}/cancel")
    assert cancelled["state"] == "cancelled"
    assert api.ok("POST", f"/v1/jobs/{first}/cancel") == cancelled
    assert [job["id"] for job in api.ok("GET", "/v1/jobs?state=queued")["items"]] == [second]

    api.worker.work()
    assert api.ok("GET", f"/v1/jobs/{second}")["state"] == "done"
    refused = api.post(f"/v1/jobs/{second}/cancel")
    assert refused.status_code == 409
    assert "done already" in refused.json()["detail"]


def test_jobs_take_the_scope_of_what_caused_them(api: Api) -> None:
    session_id = api.session_id()
    api.worker.idle = True
    level_id = api.ok("GET", f"/v1/sessions/{session_id}")["level_id"]
    api.ok("POST", f"/v1/sessions/{session_id}/segments", json=plain(segment_body()))
    api.ok("POST", "/v1/maps", json={"level_id": level_id})
    waiting = api.ok("GET", "/v1/jobs?state=queued")["items"]
    assert {job["kind"] for job in waiting} == {"build_map", "locate_segment"}
    ids = {job["kind"]: job["id"] for job in waiting}
    for scope, own, foreign in (
        (Scope.LOCATE, "locate_segment", "build_map"),
        (Scope.SURVEY, "build_map", "locate_segment"),
    ):
        assert [job["id"] for job in api.ok("GET", "/v1/jobs?state=queued", key=scope)["items"]] == [ids[own]]
        assert {job["kind"] for job in api.ok("GET", "/v1/jobs", key=scope)["items"]} == {own}
        assert api.get(f"/v1/jobs/{ids[own]}", key=scope).status_code == 200
        for response in (
            api.get(f"/v1/jobs?kind={foreign}", key=scope),
            api.get(f"/v1/jobs/{ids[foreign]}", key=scope),
            api.post(f"/v1/jobs/{ids[foreign]}/cancel", key=scope),
        ):
            assert response.status_code == 403
            assert response.json()["type"].endswith("/forbidden")
        assert api.ok("GET", f"/v1/jobs/{ids[foreign]}")["state"] == "queued"
    for scope, kind in ((Scope.LOCATE, "locate_segment"), (Scope.SURVEY, "build_map")):
        assert api.ok("POST", f"/v1/jobs/{ids[kind]}/cancel", key=scope)["state"] == "cancelled"


def test_a_key_of_both_scopes_sees_both_kinds(api: Api) -> None:
    secret = api.ok("POST", "/v1/keys", json={"name": "both", "scopes": ["locate", "survey"]})["secret"]
    session_id = api.session_id()
    api.ok("POST", f"/v1/sessions/{session_id}/segments", json=plain(segment_body()))
    kinds = {job["kind"] for job in api.ok("GET", "/v1/jobs", key=secret)["items"]}
    assert kinds == {"build_map", "locate_segment"}


def test_unknown_filters_are_refused(api: Api) -> None:
    (error,) = api.get("/v1/jobs?state=lost").json()["errors"]
    assert error["field"] == "state"
    assert "'queued'" in error["remedy"]
