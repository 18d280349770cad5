"""Webhooks over HTTP."""

from __future__ import annotations

from typing import Any

import pytest

from app.services.webhook_records import Attempt
from tests.api.harness import Api

BODY = {"url": "https://hooks.example.org/x", "events": ["session.closed", "geofence.enter"]}


def create(api: Api, **changes: Any) -> Any:
    return api.ok("POST", "/v1/webhooks", json={**BODY, **changes})


def test_the_secret_is_told_once(api: Api) -> None:
    response = api.post("/v1/webhooks", json=BODY)
    made = response.json()
    assert response.status_code == 201
    assert response.headers["Cache-Control"] == "no-store"
    assert made["secret"].startswith("whsec_")
    path = response.headers["Location"]
    shown = api.get(path)
    assert shown.json() == {name: value for name, value in made.items() if name != "secret"}
    assert made["secret"] not in shown.text + api.get("/v1/webhooks").text
    assert shown.json()["events"] == ["geofence.enter", "session.closed"]
    changed = api.ok("PATCH", path, json={"active": False, "events": ["map.published"]})
    assert (changed["active"], changed["events"], changed["url"]) == (False, ["map.published"], BODY["url"])
    assert api.call("DELETE", path).status_code == 204
    assert api.get(path).status_code == 404


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"url": "http://hooks.example.org/"}, "url"),
        ({"url": "https://127.0.0.1/"}, "url"),
        ({"url": ""}, "url"),
        ({"events": ["test"]}, "events.0"),
        ({"events": []}, "events"),
        ({"active": "yes please"}, "active"),
        ({"secret": "mine"}, "secret"),
    ],
)
def test_refusals_name_the_field_and_the_remedy(api: Api, changes: dict[str, Any], field: str) -> None:
    response = api.post("/v1/webhooks", json={**BODY, **changes})
    assert response.status_code == 422, response.text
    (error,) = response.json()["errors"]
    assert error["field"] == field
    assert error["remedy"]
    if "url" in changes:
        path = f"/v1/webhooks/{create(api)['id']}"
        assert api.call("PATCH", path, json=changes).status_code == 422


def test_a_place_that_is_not_there_is_not_found(api: Api) -> None:
    for name in ("venue_id", "level_id"):
        assert api.post("/v1/webhooks", json={**BODY, name: "xyz_0"}).status_code == 404


def test_deliveries_tell_what_became_of_messages(api: Api) -> None:
    hook = create(api)
    path = f"/v1/webhooks/{hook['id']}"
    response = api.post(f"{path}/test")
    assert response.status_code == 202
    queued = response.json()
    assert queued["message"]["type"] == "test"
    assert (queued["state"], queued["attempts"], queued["event_id"]) == ("pending", 0, queued["message"]["id"])
    again = f"{path}/deliveries/{queued['id']}/redeliver"
    assert api.post(again).status_code == 409
    ((_, delivery),) = api.services.outbox.due(limit=9)
    api.services.outbox.settle(delivery, Attempt(500, "answered 500"))
    (failed,) = api.ok("GET", f"{path}/deliveries?state=pending")["items"]
    assert (failed["last_status"], failed["last_error"], failed["attempts"]) == (500, "answered 500", 1)
    assert failed["next_attempt_at"] > failed["last_attempt_at"]
    api.services.outbox.settle(api.services.webhooks.deliveries(hook["id"]).items[0], Attempt(204))
    assert api.ok("GET", f"{path}/deliveries?state=pending")["items"] == []
    repeated = api.ok("POST", again)
    assert (repeated["event_id"], repeated["message"]) == (queued["event_id"], queued["message"])
    page = api.get(f"{path}/deliveries?limit=1")
    assert page.json()["items"] == [repeated]
    assert 'rel="next"' in page.headers["Link"]
    api.ok("PATCH", path, json={"active": False})
    assert api.post(f"{path}/test").status_code == 409
