from __future__ import annotations

import pytest

from app.services.records import Scope
from tests.api.harness import Api


def test_the_secret_is_told_once(api: Api) -> None:
    response = api.post("/v1/keys", json={"name": "phone app", "scopes": ["survey", "locate"]})
    assert response.status_code == 201
    assert response.headers["Cache-Control"] == "no-store"
    made = response.json()
    secret = made.pop("secret")
    assert made["scopes"] == ["locate", "survey"]
    assert api.get(response.headers["Location"]).json() == made
    assert secret not in api.get("/v1/keys").text
    assert api.get("/v1/devices", key=secret).status_code == 200


@pytest.mark.parametrize("scope", list(Scope))
def test_a_key_may_read_what_it_is(api: Api, scope: Scope) -> None:
    shown = api.ok("GET", "/v1/keys/current", key=scope)
    assert shown["scopes"] == [scope.value]
    assert shown["name"] == scope.value
    assert "secret" not in shown
    assert api.ok("GET", f"/v1/keys/{shown['id']}")["name"] == scope.value


def test_revoked_keys_stay_in_the_list(api: Api) -> None:
    made = api.ok("POST", "/v1/keys", json={"name": "k", "scopes": ["locate"]})
    assert api.call("DELETE", f"/v1/keys/{made['id']}").status_code == 204
    assert api.call("DELETE", f"/v1/keys/{made['id']}").status_code == 204
    shown = {item["id"]: item for item in api.ok("GET", "/v1/keys")["items"]}
    assert shown[made["id"]]["revoked_at"] is not None
    assert api.call("DELETE", "/v1/keys/key_none").status_code == 404


def test_creation_ignores_idempotency_keys(api: Api) -> None:
    headers = {"Idempotency-Key": "same"}
    made = [
        api.ok("POST", "/v1/keys", json={"name": "k", "scopes": ["locate"]}, headers=headers)["id"] for _ in range(2)
    ]
    assert len(set(made)) == 2


@pytest.mark.parametrize("scopes", [[], ["root"], "admin", None, ["admin"] * 4])
def test_scopes_are_checked(api: Api, scopes: object) -> None:
    response = api.post("/v1/keys", json={"name": "k", "scopes": scopes})
    assert response.status_code == 422
    assert response.json()["errors"][0]["field"].startswith("scopes")


def test_an_admin_may_do_everything(api: Api) -> None:
    assert api.get("/v1/surveys", key=Scope.ADMIN).status_code == 200
