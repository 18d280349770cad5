"""Refusals become typed errors; what may pass is tried again, what may do harm is not."""

from __future__ import annotations

import random
from datetime import UTC, datetime

import httpx
import isodyn_client
import pytest
from conftest import VENUE, FakeService, job, make_samples, ok, problem, segment
from hypothesis import given
from hypothesis import strategies as st
from isodyn_client import (
    Client,
    ConflictError,
    ConnectionFailedError,
    ForbiddenError,
    InvalidRequestError,
    IsodynError,
    NoAnchorError,
    NoMapError,
    NotFoundError,
    OverloadedError,
    ProblemError,
    RateLimitedError,
    RequestTimeoutError,
    RetryPolicy,
    SequenceConflictError,
    SequenceGapError,
    ServiceFailedError,
    SessionClosedError,
    TooLargeError,
    UnauthorizedError,
    UnexpectedAnswerError,
    errors,
)
from isodyn_client.retry import retry_after

NO_RETRIES = RetryPolicy(retries=0)


@pytest.mark.parametrize(
    ("status", "slug", "expected"),
    [
        (400, "malformed-body", InvalidRequestError),
        (401, "unauthorized", UnauthorizedError),
        (403, "forbidden", ForbiddenError),
        (404, "not-found", NotFoundError),
        (405, "method-not-allowed", ProblemError),
        (409, "conflict", ConflictError),
        (409, "sequence-conflict", SequenceConflictError),
        (409, "sequence-gap", SequenceGapError),
        (409, "session-closed", SessionClosedError),
        (409, "no-map", NoMapError),
        (409, "no-anchor", NoAnchorError),
        (413, "body-too-large", TooLargeError),
        (415, "unsupported-media-type", InvalidRequestError),
        (422, "invalid", InvalidRequestError),
        (429, "rate-limited", RateLimitedError),
        (500, "internal", ServiceFailedError),
        (503, "overloaded", OverloadedError),
        (503, "not-ready", ServiceFailedError),
        (507, "unheard-of", ServiceFailedError),
    ],
)
def test_problems_become_their_errors(service: FakeService, status: int, slug: str, expected: type) -> None:
    service.will(problem(status, slug))
    with service.client(retry=NO_RETRIES) as client, pytest.raises(ProblemError) as caught:
        client.venue("ven_1")
    assert type(caught.value) is expected
    assert (caught.value.status, caught.value.slug) == (status, slug)


def test_a_problem_names_field_and_remedy(service: FakeService, client: Client) -> None:
    reason = {"field": "samples.mag.x", "message": "looks like nT", "remedy": "send microtesla"}
    service.will(problem(422, "invalid", errors=[reason]))
    with pytest.raises(InvalidRequestError, match=r"samples\.mag\.x: looks like nT \(send microtesla\)") as caught:
        client.send_segment("ses_1", 0, make_samples(3))
    assert (caught.value.field, caught.value.remedy) == ("samples.mag.x", "send microtesla")


def test_refusals_of_something_in_between(service: FakeService) -> None:
    with service.client(retry=NO_RETRIES) as client:
        service.will(httpx.Response(502, text="bad gateway"))
        with pytest.raises(ServiceFailedError):
            client.venue("ven_1")
        service.will(httpx.Response(404, text="<html>"))
        with pytest.raises(UnexpectedAnswerError, match="check the address"):
            client.venue("ven_1")


def test_the_tree_in_the_docstring_is_the_tree() -> None:
    values = [*vars(errors).values(), *vars(isodyn_client).values()]
    classes = {value for value in values if isinstance(value, type) and issubclass(value, IsodynError)}
    drawn = [line for line in (errors.__doc__ or "").splitlines() if line.strip().startswith(("├", "│", "└"))]
    found = {}
    for line in drawn:
        name = line.split("── ")[1].split()[0]
        found[name] = line.index("── ") // 4
    assert set(found) == {cls.__name__ for cls in classes} - {"IsodynError"}
    for cls in classes - {IsodynError}:
        assert found[cls.__name__] == cls.__mro__.index(IsodynError), cls


def test_all_errors_are_public() -> None:
    names = {name for name, value in vars(errors).items() if isinstance(value, type) and issubclass(value, IsodynError)}
    assert names <= set(isodyn_client.__all__)


def test_reading_is_tried_again(service: FakeService, client: Client) -> None:
    service.will(problem(500, "internal"), httpx.ReadTimeout("slow"), httpx.ConnectError("refused"), ok(VENUE))
    assert client.venue("ven_1").id == "ven_1"
    assert len(service.pauses) == 3


def test_a_repeated_upload_sends_the_whole_body_again(service: FakeService, client: Client) -> None:
    service.will(httpx.ReadError("reset"), ok(segment(0)))
    client.send_segment("ses_1", 0, make_samples(40_000))
    assert service.bodies[0] == service.bodies[1]
    assert len(service.bodies[0]) > 40_000 * 44


def test_a_repeated_creation_keeps_its_idempotency_key(service: FakeService, client: Client) -> None:
    service.will(httpx.ReadTimeout("slow"), ok(VENUE))
    client.create_venue("Mall")
    first, second = (request.headers["Idempotency-Key"] for request in service.requests)
    assert first == second


@pytest.mark.parametrize("failure", [httpx.ReadTimeout("slow"), httpx.ReadError("reset"), problem(500, "internal")])
def test_what_may_have_happened_is_not_repeated(service: FakeService, client: Client, failure: object) -> None:
    service.will(failure)  # type: ignore[arg-type]
    with pytest.raises(IsodynError):
        client.request_map("lev_1")
    assert len(service.requests) == 1


@pytest.mark.parametrize("failure", [httpx.ConnectError("refused"), problem(429, "rate-limited")])
def test_what_cannot_have_happened_is_repeated(service: FakeService, client: Client, failure: object) -> None:
    service.will(failure, ok(job("queued"), 202))  # type: ignore[arg-type]
    assert client.request_map("lev_1").id == "job_1"


@pytest.mark.parametrize("status", [400, 401, 403, 404, 409, 413, 422])
def test_a_clear_no_is_not_repeated(service: FakeService, client: Client, status: int) -> None:
    service.will(problem(status, "whatever"))
    with pytest.raises(ProblemError):
        client.venue("ven_1")
    assert service.pauses == []


def test_retry_after_is_respected(service: FakeService, client: Client) -> None:
    service.will(problem(503, "overloaded", **{"Retry-After": "7"}), ok(VENUE))
    client.venue("ven_1")
    assert service.pauses == [7.0]


def test_a_long_retry_after_is_told_instead_of_waited_for(service: FakeService, client: Client) -> None:
    service.will(problem(429, "rate-limited", **{"Retry-After": "3600"}))
    with pytest.raises(RateLimitedError) as caught:
        client.venue("ven_1")
    assert (caught.value.retry_after_s, service.pauses) == (3600.0, [])


def test_retries_end(service: FakeService) -> None:
    service.will(*(httpx.ConnectError("refused") for _ in range(3)))
    with service.client(retry=RetryPolicy(retries=2)) as client, pytest.raises(ConnectionFailedError) as caught:
        client.venue("ven_1")
    assert not isinstance(caught.value, RequestTimeoutError)
    assert "GET /v1/venues/ven_1: refused" in str(caught.value)
    assert len(service.requests) == 3


def test_time_outs_have_their_own_error(service: FakeService) -> None:
    service.will(httpx.ReadTimeout("slow"))
    with service.client(retry=NO_RETRIES) as client, pytest.raises(RequestTimeoutError):
        client.venue("ven_1")


@given(attempt=st.integers(0, 60), seed=st.integers(0, 2**32))
def test_pauses_grow_but_stay_bounded(attempt: int, seed: int) -> None:
    policy = RetryPolicy(base_s=0.25, max_pause_s=8.0)
    pause = policy.pause_s(attempt, random.Random(seed))
    longest = min(8.0, 0.25 * 2**attempt)
    assert longest / 2 <= pause <= longest


@pytest.mark.parametrize(
    ("value", "expected"),
    [("", None), ("12", 12.0), ("Sun, 22 Nov 2026 09:00:30 GMT", 30.0), ("Sun, 22 Nov 2026 08:00:00 GMT", 0.0),
     ("soon", None)],
)  # fmt: skip
def test_retry_after_forms(value: str, expected: float | None) -> None:
    response = httpx.Response(503, headers={"Retry-After": value})
    assert retry_after(response, datetime(2026, 11, 22, 9, 0, tzinfo=UTC)) == expected
