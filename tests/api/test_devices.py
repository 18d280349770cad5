from __future__ import annotations

from app.services.records import Scope
from tests.api.harness import Api


def test_register_and_read(api: Api) -> None:
    response = api.post("/v1/devices", key=Scope.LOCATE, json={"name": "phone", "model": "OPPO PBCM10"})
    assert response.status_code == 201
    device = response.json()
    assert (device["name"], device["model"]) == ("phone", "OPPO PBCM10")
    assert api.get(response.headers["Location"]).json() == device
    assert api.ok("GET", "/v1/devices")["items"] == [device]


def test_the_model_may_be_unknown(api: Api) -> None:
    assert api.ok("POST", "/v1/devices", json={"name": "phone"})["model"] is None
