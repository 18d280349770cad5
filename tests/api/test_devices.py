from __future__ import annotations

from dataclasses import replace

import pytest

from app.engine.calibration import next_session, remember, unknown_device
from app.engine.types import Progress
from app.services.records import Scope
from app.services.tasks import LocateResult, LocateSpec
from tests.api import harness
from tests.api.harness import Api, plain, segment_body
from tests.support.builders import answer_locate, calibration


def test_register_and_read(api: Api) -> None:
    response = api.post("/v1/devices", key=Scope.LOCATE, json={"name": "phone", "model": "OPPO PBCM10"})
    assert response.status_code == 201
    device = response.json()
    assert (device["name"], device["model"]) == ("phone", "OPPO PBCM10")
    assert api.get(response.headers["Location"]).json() == {
        **device,
        "calibrations": [],
        "next_session": {"epoch": "", "source": "none", "calibration": None},
    }
    assert api.ok("GET", "/v1/devices")["items"] == [device]


def test_what_sessions_taught_is_shown_and_forgotten(api: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(harness, "answer_locate", learning)
    level_id = api.mapped_level().id
    device_id = api.ok("POST", "/v1/devices", json={"name": "phone"})["id"]
    opening = {"level_id": level_id, "device_id": device_id, "calibration_epoch": "bias-1"}
    first = api.ok("POST", "/v1/sessions", key=Scope.LOCATE, json=opening)
    assert (first["calibration_epoch"], first["calibration"]) == ("bias-1", None)
    path = f"/v1/sessions/{first['id']}"
    api.ok("POST", f"{path}/segments", json=plain(segment_body(0)))
    assert api.ok("GET", f"/v1/devices/{device_id}")["calibrations"] == []
    api.ok("POST", f"{path}/close")
    device = api.ok("GET", f"/v1/devices/{device_id}", key=Scope.LOCATE)
    (known,) = device["calibrations"]
    expected = remember(unknown_device(), None, calibration(6.0))
    assert (known["epoch"], known["n_sessions"]) == ("bias-1", 1)
    assert known["offset"] == list(expected.offset)
    assert known["offset_sd"] == list(expected.offset_sd)
    assert (known["stride_scale"], known["stride_scale_sd"]) == (expected.stride_scale, expected.stride_scale_sd)
    assert (known["soft_iron"], known["soft_iron_sd"]) == (list(expected.soft_iron), list(expected.soft_iron_sd))
    assert known["updated_at"]

    second = api.ok("POST", "/v1/sessions", json=opening)
    start = next_session(expected)
    assert second["calibration"] == {
        "offset": list(start.offset),
        "offset_sd": list(start.offset_sd),
        "stride_scale": start.stride_scale,
        "stride_scale_sd": start.stride_scale_sd,
        "soft_iron": list(start.soft_iron),
        "soft_iron_sd": list(start.soft_iron_sd),
    }
    assert start.soft_iron[0] > 0.01
    assert api.ok("GET", f"/v1/sessions/{second['id']}") == second
    other = api.ok("POST", "/v1/sessions", json={**opening, "calibration_epoch": "bias-2"})
    assert other["calibration"]["offset_sd"] == [5.5, 5.5, 5.5]
    assert other["calibration"]["stride_scale"] == start.stride_scale
    assert other["calibration"]["soft_iron"] == [0.0] * 6

    response = api.call("DELETE", f"/v1/devices/{device_id}/calibrations", key=Scope.LOCATE)
    assert (response.status_code, response.content) == (204, b"")
    assert api.ok("GET", f"/v1/devices/{device_id}")["calibrations"] == []
    assert api.ok("POST", "/v1/sessions", json=opening)["calibration"] is None
    assert api.ok("GET", f"/v1/sessions/{second['id']}") == second
    assert api.call("DELETE", "/v1/devices/dev_none/calibrations").status_code == 404


def learning(spec: LocateSpec, progress: Progress) -> LocateResult:
    """A locate task that learns the same each time."""
    return replace(answer_locate(spec, progress), calibration=calibration(6.0))


def test_the_model_may_be_unknown(api: Api) -> None:
    assert api.ok("POST", "/v1/devices", json={"name": "phone"})["model"] is None
