from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

import pytest

from app.services.records import Scope
from tests.api.harness import Api

KEY = {"Idempotency-Key": "5f3c1d3e-0b7e-4c55-9d3b-0c3e6d1f2a77"}


def venue(api: Api) -> tuple[str, dict[str, Any]]:
    return "/v1/venues", {"name": "Mall"}


def level(api: Api) -> tuple[str, dict[str, Any]]:
    extent = {"x_min": 0, "y_min": 0, "x_max": 1, "y_max": 1}
    return f"/v1/venues/{api.level().venue_id}/levels", {"name": "F1", "extent": extent}


def device(api: Api) -> tuple[str, dict[str, Any]]:
    return "/v1/devices", {"name": "phone"}


def survey(api: Api) -> tuple[str, dict[str, Any]]:
    return "/v1/surveys", {"level_id": api.level().id, "name": "spring"}


def session(api: Api) -> tuple[str, dict[str, Any]]:
    return "/v1/sessions", {"level_id": api.mapped_level().id}


CREATIONS = [venue, level, device, survey, session]


@pytest.mark.parametrize("creation", CREATIONS)
def test_the_same_request_creates_once(api: Api, creation: Callable[[Api], tuple[str, dict[str, Any]]]) -> None:
    path, body = creation(api)
    first = api.post(path, json=body, headers=KEY)
    assert first.status_code == 201
    assert "Idempotency-Replayed" not in first.headers
    before = api.stored()
    again = api.post(path, json=body, headers=KEY)
    assert (again.status_code, again.json(), again.headers["Idempotency-Replayed"]) == (201, first.json(), "true")
    assert again.headers["Location"] == first.headers["Location"]
    assert api.stored() == before
    assert api.post(path, json=body).json()["id"] != first.json()["id"]


@pytest.mark.parametrize("creation", CREATIONS)
def test_another_request_under_the_same_key_is_refused(
    api: Api, creation: Callable[[Api], tuple[str, dict[str, Any]]]
) -> None:
    path, body = creation(api)
    api.ok("POST", path, json=body, headers=KEY)
    before = api.stored()
    other = {**body, "parameters": {"particles": 500}} if path == "/v1/sessions" else {**body, "name": "other"}
    refused = api.post(path, json=other, headers=KEY)
    assert refused.status_code == 422
    assert refused.json()["type"].endswith("/idempotency-reuse")
    assert api.stored() == before


def test_the_same_key_on_another_path_is_refused(api: Api) -> None:
    api.ok("POST", "/v1/venues", json={"name": "x"}, headers=KEY)
    assert api.post("/v1/devices", json={"name": "x"}, headers=KEY).status_code == 422


def test_callers_do_not_see_each_others_keys(api: Api) -> None:
    first = api.ok("POST", "/v1/venues", key=Scope.SURVEY, json={"name": "x"}, headers=KEY)
    second = api.ok("POST", "/v1/venues", key=Scope.ADMIN, json={"name": "x"}, headers=KEY)
    assert first["id"] != second["id"]


def test_a_refused_request_leaves_the_key_free(api: Api) -> None:
    assert api.post("/v1/venues", json={"name": ""}, headers=KEY).status_code == 422
    assert api.post("/v1/venues", json={"name": "x"}, headers=KEY).status_code == 201


def test_what_was_deleted_is_not_created_again(api: Api) -> None:
    made = api.ok("POST", "/v1/venues", json={"name": "x"}, headers=KEY)
    assert api.call("DELETE", f"/v1/venues/{made['id']}").status_code == 204
    refused = api.post("/v1/venues", json={"name": "x"}, headers=KEY)
    assert refused.status_code == 422
    assert "deleted" in refused.json()["detail"]


def test_requests_at_the_same_time_create_once(api: Api) -> None:
    async def both() -> list[str]:
        calls = (api.acall("POST", "/v1/venues", json={"name": "x"}, headers=KEY) for _ in range(8))
        return [response.json()["id"] for response in await asyncio.gather(*calls)]

    assert len(set(asyncio.run(both()))) == 1
    assert api.stored()["venues"] == 1


@pytest.mark.parametrize("key", ["", "a b", "x" * 256, "\t"])
def test_the_key_is_checked(api: Api, key: str) -> None:
    response = api.post("/v1/venues", json={"name": "x"}, headers={"Idempotency-Key": key})
    assert response.status_code == 422
    assert response.json()["errors"][0]["field"] == "Idempotency-Key"
    assert api.stored()["venues"] == 0
