"""Who may call what: over every route of the application."""

from __future__ import annotations

import re
from collections.abc import Callable

import pytest
from fastapi.routing import iter_route_contexts

from app.api.auth import KEY_CACHE_S, Access, KeyCache, scope_word
from app.api.routing import ApiRoute, UndeclaredAccessError, api_router
from app.services.records import ApiKey, Scope
from tests.api.harness import Api
from tests.support.builders import START

LOCATE, SURVEY, ADMIN = Access(Scope.LOCATE), Access(Scope.SURVEY), Access(Scope.ADMIN)
ANY, PUBLIC = Access(None), Access(None, public=True)
TOKEN = Access(None, public=True, by_token=True)

TABLE = {
    "GET /healthz": PUBLIC,
    "GET /readyz": PUBLIC,
    "GET /metrics": PUBLIC,
    "GET /docs": PUBLIC,
    "GET /openapi.json": PUBLIC,
    "GET /v1/sessions/{session_id}/events": LOCATE,
    "GET /v1/live": LOCATE,
    "POST /v1/ingest-tokens": LOCATE,
    "GET /v1/ingest-tokens": LOCATE,
    "GET /v1/ingest-tokens/{token_id}": LOCATE,
    "DELETE /v1/ingest-tokens/{token_id}": LOCATE,
    "POST /v1/ingest/sensor-logger/{token}": TOKEN,
    "POST /v1/ingest/phyphox/{token}": TOKEN,
    "GET /v1/ingest/phyphox/{token}/experiment.phyphox": TOKEN,
    "GET /v1/recordings": LOCATE,
    "GET /v1/recordings/{recording_id}": LOCATE,
    "POST /v1/recordings/{recording_id}/close": LOCATE,
    "PUT /v1/recordings/{recording_id}/waypoints": SURVEY,
    "GET /v1/levels/{level_id}/markers": ANY,
    "PUT /v1/levels/{level_id}/markers": SURVEY,
    "POST /v1/venues": SURVEY,
    "GET /v1/venues": ANY,
    "GET /v1/venues/{venue_id}": ANY,
    "PATCH /v1/venues/{venue_id}": SURVEY,
    "DELETE /v1/venues/{venue_id}": SURVEY,
    "POST /v1/venues/{venue_id}/levels": SURVEY,
    "GET /v1/levels": ANY,
    "GET /v1/levels/{level_id}": ANY,
    "PATCH /v1/levels/{level_id}": SURVEY,
    "PUT /v1/levels/{level_id}/plan.png": SURVEY,
    "GET /v1/levels/{level_id}/plan.png": ANY,
    "PUT /v1/levels/{level_id}/plan.geojson": SURVEY,
    "GET /v1/levels/{level_id}/plan.geojson": ANY,
    "PUT /v1/levels/{level_id}/map": SURVEY,
    "GET /v1/levels/{level_id}/publications": SURVEY,
    "GET /v1/levels/{level_id}/waypoints": SURVEY,
    "POST /v1/devices": LOCATE,
    "GET /v1/devices": LOCATE,
    "GET /v1/devices/{device_id}": LOCATE,
    "DELETE /v1/devices/{device_id}/calibrations": LOCATE,
    "GET /v1/device-models": SURVEY,
    "GET /v1/device-models/{name}": SURVEY,
    "POST /v1/surveys": SURVEY,
    "GET /v1/surveys": SURVEY,
    "GET /v1/surveys/{survey_id}": SURVEY,
    "POST /v1/surveys/{survey_id}/walks": SURVEY,
    "GET /v1/surveys/{survey_id}/walks": SURVEY,
    "GET /v1/surveys/{survey_id}/walks/{walk_id}": SURVEY,
    "DELETE /v1/surveys/{survey_id}/walks/{walk_id}": SURVEY,
    "POST /v1/surveys/{survey_id}/import": SURVEY,
    "POST /v1/maps": SURVEY,
    "GET /v1/maps": ANY,
    "GET /v1/maps/{map_id}": ANY,
    "GET /v1/maps/{map_id}/field": ANY,
    "GET /v1/maps/{map_id}/coverage": ANY,
    "GET /v1/contributions": SURVEY,
    "GET /v1/contributions/{contribution_id}": SURVEY,
    "POST /v1/contributions/{contribution_id}/reject": ADMIN,
    "POST /v1/contributions/{contribution_id}/restore": ADMIN,
    "DELETE /v1/contributions/{contribution_id}": ADMIN,
    "GET /v1/changes": SURVEY,
    "GET /v1/maps/{map_id}/sources": SURVEY,
    "GET /v1/maps/{map_id}/diff": ANY,
    "GET /v1/maps/{map_id}/quality": ANY,
    "GET /v1/maps/{map_id}/quality/raster": ANY,
    "GET /v1/maps/{map_id}/suggestions": ANY,
    "POST /v1/maps/{map_id}/forecast": ANY,
    "GET /v1/maps/{map_id}/export": ANY,
    "POST /v1/levels/{level_id}/maps/import": SURVEY,
    "GET /v1/surveys/{survey_id}/export": SURVEY,
    "POST /v1/sessions": LOCATE,
    "GET /v1/sessions": LOCATE,
    "GET /v1/sessions/{session_id}": LOCATE,
    "POST /v1/sessions/{session_id}/close": LOCATE,
    "POST /v1/sessions/{session_id}/segments": LOCATE,
    "GET /v1/sessions/{session_id}/segments": LOCATE,
    "GET /v1/sessions/{session_id}/segments/{seq}": LOCATE,
    "GET /v1/sessions/{session_id}/positions": LOCATE,
    "GET /v1/sessions/{session_id}/trajectory": LOCATE,
    "GET /v1/sessions/{session_id}/track": LOCATE,
    "GET /v1/sessions/{session_id}/samples": LOCATE,
    "GET /v1/sessions/{session_id}/profile": LOCATE,
    "POST /v1/sessions/{session_id}/replay": LOCATE,
    "POST /v1/sessions/{session_id}/ground-truth": LOCATE,
    "GET /v1/sessions/{session_id}/ground-truth": LOCATE,
    "DELETE /v1/sessions/{session_id}/ground-truth": LOCATE,
    "POST /v1/geofences": SURVEY,
    "GET /v1/geofences": ANY,
    "GET /v1/geofences/{geofence_id}": ANY,
    "PATCH /v1/geofences/{geofence_id}": SURVEY,
    "DELETE /v1/geofences/{geofence_id}": SURVEY,
    "GET /v1/geofence-events": LOCATE,
    "POST /v1/webhooks": ADMIN,
    "GET /v1/webhooks": ADMIN,
    "GET /v1/webhooks/{webhook_id}": ADMIN,
    "PATCH /v1/webhooks/{webhook_id}": ADMIN,
    "DELETE /v1/webhooks/{webhook_id}": ADMIN,
    "GET /v1/webhooks/{webhook_id}/deliveries": ADMIN,
    "POST /v1/webhooks/{webhook_id}/test": ADMIN,
    "POST /v1/webhooks/{webhook_id}/deliveries/{delivery_id}/redeliver": ADMIN,
    "POST /v1/locate": LOCATE,
    "GET /v1/jobs": ANY,
    "GET /v1/jobs/{job_id}": ANY,
    "POST /v1/jobs/{job_id}/cancel": ANY,
    "GET /v1/methods": ANY,
    "GET /v1/methods/{name}": ANY,
    "POST /v1/keys": ADMIN,
    "GET /v1/keys": ADMIN,
    "GET /v1/keys/current": ANY,
    "GET /v1/keys/{key_id}": ADMIN,
    "DELETE /v1/keys/{key_id}": ADMIN,
    "GET /v1/stats": ADMIN,
    "GET /v1/stats/throughput": ADMIN,
    "GET /v1/stats/latency": ADMIN,
    "GET /v1/stats/backlog": ADMIN,
    "GET /v1/stats/errors": ADMIN,
    "GET /v1/stats/fixes": ADMIN,
    "GET /v1/stats/accuracy": ADMIN,
    "GET /v1/stats/storage": ADMIN,
    "GET /v1/stats/levels": ADMIN,
    "GET /v1/stats/alarms": ADMIN,
}
GUARDED = {name: access for name, access in TABLE.items() if not access.public}
SOCKETS = {"/v1/sessions/{session_id}/stream"}
"""WebSockets check their caller themselves: tests/e2e/test_streams.py."""


def routes_of(api: Api) -> dict[str, Access]:
    found = {}
    for context in iter_route_contexts(api.app.routes):
        route = context.original_route
        if context.path in SOCKETS:
            continue
        assert isinstance(route, ApiRoute), f"{context.path} is not an ApiRoute: nothing checks its caller"
        for method in route.methods or ():
            found[f"{method} {route.path.replace(':path}', '}')}"] = Access(
                route.access.scope, public=route.access.public, by_token=route.access.by_token
            )
    return found


def call(api: Api, name: str, key: Scope | str | None) -> tuple[int, str]:
    method, path = name.split(" ")
    response = api.call(method, re.sub(r"\{seq\}", "0", re.sub(r"\{\w+_id\}|\{name\}", "x_1", path)), key=key)
    problem = response.headers["content-type"] == "application/problem+json"
    return response.status_code, response.json()["type"].rpartition("/")[2] if problem else ""


def test_every_route_declares_the_access_of_the_table(api: Api) -> None:
    assert routes_of(api) == TABLE


def test_a_route_without_declared_access_cannot_exist() -> None:
    with pytest.raises(UndeclaredAccessError):
        api_router("x").get("/x")(lambda: None)


def test_the_matrix(api: Api) -> None:
    api.hub.close()  # or streams would never end
    for name, access in GUARDED.items():
        assert call(api, name, None) == (401, "unauthorized"), name
        assert call(api, name, "isk_unknown") == (401, "unauthorized"), name
        for scope in Scope:
            allowed = access.scope is None or scope in (access.scope, Scope.ADMIN)
            status, slug = call(api, name, scope)
            assert (slug == "forbidden") == (not allowed), f"{name} as {scope}: {status} {slug}"
            assert status != 401, f"{name} as {scope}"


def test_public_routes_need_no_key(api: Api) -> None:
    for name, access in TABLE.items():
        if scope_word(access) == "none":
            assert call(api, name, None)[0] == 200, name


def test_routes_with_a_token_in_the_path_refuse_another_one(api: Api) -> None:
    for name, access in TABLE.items():
        if scope_word(access) == "token":
            method, path = name.split()
            answer = api.call(method, path.replace("{token}", "isi_unknown"), key=None, json={})
            assert (answer.status_code, "isi_unknown" in answer.text) == (499, False), name


@pytest.mark.parametrize(
    "headers", [{"X-API-Key": "{}"}, {"Authorization": "Bearer {}"}, {"Authorization": "bearer {}"}]
)
def test_both_headers_work(api: Api, headers: dict[str, str]) -> None:
    secret = api.secrets[Scope.LOCATE]
    given = {name: value.format(secret) for name, value in headers.items()}
    assert api.get("/v1/venues", key=None, headers=given).status_code == 200


def test_two_different_keys_are_one_too_many(api: Api) -> None:
    good = api.secrets[Scope.LOCATE]
    for bearer, status in ((good, 200), ("isk_other", 401)):
        headers = {"X-API-Key": good, "Authorization": f"Bearer {bearer}"}
        assert api.get("/v1/venues", key=None, headers=headers).status_code == status


def test_a_proxys_own_credentials_do_not_matter(api: Api) -> None:
    headers = {"X-API-Key": api.secrets[Scope.LOCATE], "Authorization": "Basic dTpw"}
    assert api.get("/v1/venues", key=None, headers=headers).status_code == 200


@pytest.mark.parametrize(
    "headers",
    [
        {"Authorization": "Basic dTpw"},
        {"Authorization": "Bearer "},
        {"Authorization": "Bearer"},
        {"X-API-Key": ""},
        {"X-API-Key": "x" * 10_000},
    ],
)
def test_other_credentials_do_not(api: Api, headers: dict[str, str]) -> None:
    response = api.get("/v1/venues", key=None, headers=headers)
    assert response.status_code == 401
    assert response.headers["WWW-Authenticate"].startswith("Bearer")


def test_a_revoked_key_is_refused_at_once(api: Api) -> None:
    made = api.ok("POST", "/v1/keys", json={"name": "short-lived", "scopes": ["locate"]})
    assert api.get("/v1/venues", key=made["secret"]).status_code == 200
    assert api.call("DELETE", f"/v1/keys/{made['id']}").status_code == 204
    assert api.get("/v1/venues", key=made["secret"]).status_code == 401


def test_the_key_comes_before_the_body(api: Api) -> None:
    assert (
        api.post("/v1/venues", key=None, content=b"{", headers={"Content-Type": "application/json"}).status_code == 401
    )


def test_secrets_are_asked_for_once_and_then_trusted_for_a_while() -> None:
    now, asked = [0.0], []
    key = ApiKey("key_1", "k", frozenset({Scope.LOCATE}), START, None, None)

    def verify(secret: str) -> ApiKey | None:
        asked.append(secret)
        return key if secret == "good" else None

    cache = KeyCache(verify, lambda: now[0])
    assert cache.cached("good") is None
    assert cache.verify("good") == key
    assert cache.cached("good") == key
    now[0] = KEY_CACHE_S
    assert cache.cached("good") is None
    assert cache.verify("bad") is None
    assert cache.cached("bad") is None
    assert asked == ["good", "bad"]


def test_a_revocation_during_verification_wins() -> None:
    key = ApiKey("key_1", "k", frozenset({Scope.LOCATE}), START, None, None)
    forget: list[Callable[[], None]] = []

    def verify(_: str) -> ApiKey:
        forget[0]()
        return key

    cache = KeyCache(verify)
    forget.append(cache.forget_all)
    cache.verify("secret")
    assert cache.cached("secret") is None
