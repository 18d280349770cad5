"""Between the engine's types and the client's, and the evaluation's view of a service."""

from __future__ import annotations

import math
from dataclasses import replace

import httpx
import isodyn_client as isodyn
import msgpack
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.cli.convert import fixes_from, prior_of, to_ms
from app.cli.transport import ServiceTransport
from app.engine.types import FixKind, ImuSamples, Prior, Segment, Status
from app.evaluation.errors import TransportError
from tests.support.builders import all_aids


@given(st.lists(st.integers(0, 4_000_000_000_000), min_size=1, max_size=50, unique=True))
def test_whole_milliseconds_stay_whole(ms: list[int]) -> None:
    seconds = np.array(sorted(ms)) / 1000.0
    assert to_ms(seconds).tolist() == sorted(ms)


@given(heading=st.none() | st.floats(-math.pi, math.pi), sd=st.floats(0.01, 3.0))
def test_priors_turn_to_degrees(heading: float | None, sd: float) -> None:
    prior = prior_of(Prior("lvl_1", x=1.0, y=2.0, heading=heading, heading_sd=sd))
    assert (prior.x, prior.y) == (1.0, 2.0)
    if heading is None:
        assert prior.model_dump(exclude_none=True) == {"x": 1.0, "y": 2.0, "radius_m": 3.0}
    else:
        assert math.radians(prior.heading_deg or 0.0) == pytest.approx(heading, abs=1e-12)
        assert math.radians(prior.heading_sd_deg or 0.0) == pytest.approx(sd)


def columns(n: int) -> dict[str, list[object]]:
    floats = {name: [float(i) for i in range(n)] for name in ("x", "y", "cov_xx", "cov_xy", "cov_yy", "quality")}
    return {
        **floats,
        "t_ms": [1000.0 * i for i in range(n)],
        "heading_deg": [90.0] * n,
        "kind": ["fixed_lag"] * n,
        "status": ["insufficient"] * n,
        "sure": [False] * n,
        "walk_on_m": [None if i else 12.0 for i in range(n)],
        "level_id": ["lvl_1"] * n,
    }


def answer(state: str, fixes: object = None, error: str | None = None) -> httpx.Response:
    body = {"session_id": "ses_1", "seq": 0, "state": state, "fixes": fixes, "error": error, "position": None}
    return httpx.Response(200, json=body)


def transport_with(*answers: httpx.Response) -> ServiceTransport:
    pending = list(answers)
    mock = httpx.MockTransport(lambda _request: pending.pop(0))
    return ServiceTransport(isodyn.Client("http://service.test", transport=mock, sleep=lambda _: None))


SEGMENT = Segment(ImuSamples(np.arange(3.0), np.ones((3, 3)), np.ones((3, 3)), np.ones((3, 3))))


def test_fixes_come_back_as_the_engines() -> None:
    fixes = transport_with(answer("done", columns(2))).send_segment("ses_1", 0, SEGMENT)
    assert [fix.t for fix in fixes] == [0.0, 1.0]
    assert fixes[0].heading == pytest.approx(math.pi / 2)
    assert (fixes[0].walk_on_m, fixes[1].walk_on_m) == (12.0, None)
    assert fixes[0].status is Status.INSUFFICIENT
    assert fixes[0].kind is FixKind.FIXED_LAG


def test_aids_of_a_segment_are_sent() -> None:
    sent: list[httpx.Request] = []

    def handle(request: httpx.Request) -> httpx.Response:
        sent.append(request)
        return answer("done", columns(1))

    client = isodyn.Client("http://service.test", transport=httpx.MockTransport(handle))
    aids = all_aids(t0=0.0)
    segment = replace(SEGMENT, wifi=aids.wifi, ble=aids.ble, pressure=aids.pressure, speed=aids.speed, steps=aids.steps)
    ServiceTransport(client).send_segment("ses_1", 0, segment)
    value = msgpack.unpackb(sent[0].content)
    assert {name for name in value if name not in ("seq", "frame", "samples")} == {
        "wifi", "ble", "pressure", "speed", "steps"
    }  # fmt: skip
    assert value["steps"] == {"t_ms": [250.0, 1500.0, 4125.0], "count": [5120.0, 5120.0, 5126.0]}
    assert value["ble"]["address"] == list(aids.ble.address)  # type: ignore[union-attr]


def test_a_slow_segment_is_waited_for() -> None:
    transport = transport_with(answer("queued"), answer("running"), answer("done", columns(1)))
    assert len(transport.send_segment("ses_1", 0, SEGMENT)) == 1


def test_a_segment_that_failed_is_accepted_all_the_same() -> None:
    transport = transport_with(answer("failed", error="no steps"))
    with pytest.raises(TransportError, match="no steps") as caught:
        transport.send_segment("ses_1", 0, SEGMENT)
    assert caught.value.accepted


def test_a_segment_that_is_refused_is_not() -> None:
    problem = {"type": "https://isodyn.dev/problems/invalid", "title": "A value cannot be accepted", "status": 422}
    with pytest.raises(TransportError, match="cannot be accepted") as caught:
        transport_with(httpx.Response(422, json=problem)).send_segment("ses_1", 0, SEGMENT)
    assert not caught.value.accepted


def test_no_fixes_are_no_fixes() -> None:
    assert fixes_from(isodyn.Fixes.concatenate([])) == ()
