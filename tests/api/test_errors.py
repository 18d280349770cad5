"""The table of problems is whole, and says no more than it should."""

from __future__ import annotations

import asyncio

import httpx
import pytest
from starlette.exceptions import HTTPException

from app.api import errors as api_errors
from app.api.errors import PROBLEM_OF, PROBLEM_TYPES, ApiError, problem_of
from app.engine.errors import EngineError, InputError
from app.services.errors import OverloadedError, ServiceError
from app.services.ports import WorkerLostError
from tests.api.harness import Api, plain, segment_body


def leaves(kind: type[Exception]) -> set[type[Exception]]:
    below = kind.__subclasses__()
    return {leaf for sub in below for leaf in leaves(sub)} | {sub for sub in below if sub.__module__.startswith("app.")}


@pytest.mark.parametrize("root", [ServiceError, ApiError, EngineError])
def test_every_error_raised_on_purpose_is_in_the_table(root: type[Exception]) -> None:
    known = set(PROBLEM_OF)
    for kind in leaves(root):
        if kind.__module__ in {"app.services.errors", "app.engine.errors", "app.api.errors"}:
            assert known & set(kind.__mro__), f"{kind.__name__} has no problem type"


def test_every_declared_problem_is_listed_once() -> None:
    declared = {value for value in vars(api_errors).values() if isinstance(value, api_errors.ProblemType)}
    assert declared == set(PROBLEM_TYPES)
    slugs = [kind.slug for kind in PROBLEM_TYPES]
    assert len(set(slugs)) == len(slugs)
    assert set(PROBLEM_OF.values()) <= declared


def test_retry_after_goes_along() -> None:
    assert problem_of(OverloadedError(2.4)).headers == {"Retry-After": "2"}
    assert problem_of(OverloadedError(0.1)).headers == {"Retry-After": "1"}
    assert problem_of(WorkerLostError("x")).headers == {"Retry-After": "1"}


def test_engine_errors_name_their_field() -> None:
    problem = problem_of(InputError("parameters.x", "must be a number"))
    assert problem.type.slug == "invalid"
    assert problem.errors[0].field == "parameters.x"


def test_problems_of_a_request_name_field_and_remedy(api: Api) -> None:
    session_id = api.session_id()
    path = f"/v1/sessions/{session_id}/segments"
    json_type = {"Content-Type": "application/json"}
    api.ok("POST", path, json=plain(segment_body()))
    other = plain(segment_body())
    other["samples"]["mag"]["x"][0] += 1.0
    gap, empty = api.post(path, json=plain(segment_body(7))), api.level().id
    conflict = api.post(path, json=other)
    api.ok("POST", f"/v1/sessions/{session_id}/close")
    for response, slug, field, remedy in (
        (api.post(path, content=b"{", headers=json_type), "malformed-body", "body", "whole body"),
        (api.post(path, content=b" " * 2**23 + b"{", headers=json_type), "body-too-large", "body", "smaller"),
        (api.post(path, content=b"x"), "unsupported-media-type", "Content-Type", "application/json"),
        (
            api.post(path, content=b"x", headers={**json_type, "Content-Encoding": "br"}),
            "unsupported-media-type",
            "Content-Encoding",
            "gzip",
        ),
        (conflict, "sequence-conflict", "seq", "next_seq"),
        (gap, "sequence-gap", "seq", "send seq 1 first"),
        (api.post(path, json=plain(segment_body(1))), "session-closed", "session_id", "open a new session"),
        (api.post("/v1/sessions", json={"level_id": empty}), "no-map", "level_id", "POST /v1/maps"),
    ):
        problem = response.json()
        assert problem["type"].endswith(f"/{slug}")
        (error,) = problem["errors"]
        assert error["field"] == field
        assert error["message"]
        assert remedy in error["remedy"]


def test_what_the_framework_refuses_is_a_problem_with_a_field_too() -> None:
    for status, slug in ((400, "malformed-body"), (413, "body-too-large"), (415, "unsupported-media-type")):
        problem = problem_of(HTTPException(status))
        assert problem.type.slug == slug
        assert problem.errors[0].remedy


def test_unforeseen_errors_tell_nothing(api: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    def break_(*_: object) -> None:
        raise RuntimeError("SELECT secret FROM somewhere")

    monkeypatch.setattr(type(api.services.venues), "get", break_)

    async def call() -> httpx.Response:
        transport = httpx.ASGITransport(app=api.app, raise_app_exceptions=False)
        async with httpx.AsyncClient(transport=transport, base_url="http://isodyn.test") as client:
            key = next(iter(api.secrets.values()))
            return await client.get("/v1/venues/ven_x", headers={"X-API-Key": key})

    response = asyncio.run(call())
    assert response.status_code == 500
    assert response.headers["Content-Type"] == "application/problem+json"
    assert response.json()["type"].endswith("/internal")
    assert "secret" not in response.text
    assert api.metrics.requests[-1] == ("GET", "/v1/venues/{venue_id}", 500)


def test_unknown_paths_are_problems_too(api: Api) -> None:
    response = api.get("/v2/venues", key=None)
    assert response.status_code == 404
    assert response.json()["instance"] == "/v2/venues"


def test_cors_is_off_by_default_and_can_be_allowed(api: Api, make_api: object) -> None:
    origin = {"Origin": "https://app.example"}
    assert "Access-Control-Allow-Origin" not in api.get("/healthz", headers=origin).headers
    allowed = make_api(cors_origins=("https://app.example",))  # type: ignore[operator]
    assert allowed.get("/healthz", headers=origin).headers["Access-Control-Allow-Origin"] == "https://app.example"
    assert "Access-Control-Allow-Origin" not in allowed.get("/healthz", headers={"Origin": "https://x.example"}).headers
