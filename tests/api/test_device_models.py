"""Models of devices over HTTP: mean and spread of several, nothing of a few, and not for everybody."""

from __future__ import annotations

from app.services.records import DeviceMemory, Scope
from tests.api.harness import Api, plain, walk_body
from tests.support.builders import calibration


def teach(api: Api, model: str, *offsets: float) -> None:
    for offset in offsets:
        device = api.services.devices.create("phone", model)
        with api.database(write=True) as uow:
            uow.devices.set_memory(DeviceMemory(device.id, "", calibration(offset), 1, api.clock()))


def test_a_model_is_told_of_several_devices_only(api: Api) -> None:
    name = "Galaxy S9/S9+"
    teach(api, name, 4.0, 5.0)
    path = "/v1/device-models/Galaxy%20S9%2FS9%2B"
    assert api.ok("GET", path) == {"name": name, "n_devices": 2, "estimate": None}
    teach(api, name, 6.0)
    estimate = api.ok("GET", path, key=Scope.SURVEY)["estimate"]
    assert estimate["n_taught"] == 3
    assert estimate["typical"]["offset"] == estimate["start"]["offset"] == estimate["spread"]["offset"]
    assert 2.0 < estimate["typical"]["offset"][0] < 6.0
    assert estimate["typical"]["offset_sd"] < estimate["start"]["offset_sd"]
    new = api.ok("POST", "/v1/devices", json={"name": "new", "model": name})
    told = api.ok("GET", f"/v1/devices/{new['id']}", key=Scope.LOCATE)["next_session"]
    assert told == {"epoch": "", "source": "model", "calibration": estimate["start"]}


def test_models_are_listed(api: Api) -> None:
    for name in ("b", "a", "b"):
        api.ok("POST", "/v1/devices", json={"name": "phone", "model": name})
    first = api.ok("GET", "/v1/device-models?limit=1")
    assert first["items"] == [{"name": "a", "n_devices": 1}]
    rest = api.ok("GET", f"/v1/device-models?cursor={first['next_cursor']}")
    assert (rest["items"], rest["next_cursor"]) == ([{"name": "b", "n_devices": 2}], None)
    assert api.get("/v1/device-models/none").status_code == 404


def test_those_who_only_locate_do_not_see_models(api: Api) -> None:
    assert api.get("/v1/device-models", key=Scope.LOCATE).status_code == 403


def test_a_walk_names_the_epoch_of_its_device(api: Api) -> None:
    survey_id = api.ok("POST", "/v1/surveys", json={"level_id": api.level().id, "name": "s"})["id"]
    device_id = api.ok("POST", "/v1/devices", json={"name": "phone"})["id"]
    body = plain(walk_body(n=20))
    path = f"/v1/surveys/{survey_id}/walks"
    alone = api.post(path, json={**body, "calibration_epoch": "bias-1"})
    assert alone.status_code == 422
    assert alone.json()["errors"][0]["field"] == "calibration_epoch"
    walk = api.ok("POST", path, json={**body, "device_id": device_id, "calibration_epoch": "bias-1"})
    assert (walk["device_id"], walk["calibration_epoch"]) == (device_id, "bias-1")
    assert api.ok("GET", f"{path}/{walk['id']}") == walk
