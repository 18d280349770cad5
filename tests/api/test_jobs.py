from __future__ import annotations

from app.services.records import Scope
from tests.api.harness import Api


def test_list_read_cancel(api: Api) -> None:
    api.worker.idle = True
    level = api.surveyed_level()
    first, second = (api.ok("POST", "/v1/maps", json={"level_id": level.id})["id"] for _ in range(2))
    assert [job["id"] for job in api.ok("GET", "/v1/jobs", key=Scope.LOCATE)["items"]] == [second, first]
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


def test_unknown_filters_are_refused(api: Api) -> None:
    (error,) = api.get("/v1/jobs?state=lost").json()["errors"]
    assert error["field"] == "state"
    assert "'queued'" in error["remedy"]
