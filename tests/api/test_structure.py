"""Small bodies that stand for large structures are refused at once, with a small answer, in little memory."""

from __future__ import annotations

import asyncio
import gzip
import math
import threading
import time
import tracemalloc
from collections.abc import Callable
from typing import Any

import msgpack
import numpy as np
import orjson
import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.api.body import decode
from app.api.errors import MAX_ERRORS, MalformedBodyError, RejectedError
from app.api.routers import locate as locate_router
from app.api.structure import (
    OBJECT_BOUNDS,
    SEGMENT_BOUNDS,
    WALK_BOUNDS,
    Bounds,
    check_json,
    decode_msgpack,
)
from app.api.uploads import LARGE_BYTES, parse
from tests.api.harness import JSON_TYPE, MSGPACK_TYPE, Api, plain, segment_body

MIB = 2**20
BOMB_S = 0.3


def keys(n: int) -> bytes:
    return b"{" + b",".join(b'"k%d":1' % i for i in range(n)) + b"}"


def nested_claims(depth: int, claim: int) -> bytes:
    """Arrays in arrays, each of which claims many elements."""
    return b"\x81\xa1a" + b"".join(b"\xdd" + claim.to_bytes(4, "big") for _ in range(depth)) + bytes(claim)


BOMBS = {
    "json arrays": (JSON_TYPE, b'{"a": [' + b"[]," * 2_500_000 + b"[]]}"),
    "json objects": (JSON_TYPE, b'{"a": [' + b"{}," * 2_500_000 + b"{}]}"),
    "json keys": (JSON_TYPE, keys(600_000)),
    "json keys with spaces": (JSON_TYPE, keys(500_000).replace(b":", b" \n:")),
    "json few long keys": (JSON_TYPE, b"{" + b",".join(b'"%d%s":1' % (i, b"k" * 30_000) for i in range(200)) + b"}"),
    "json one key again and again": (JSON_TYPE, b"{" + b'"a":1,' * 1_200_000 + b'"a":1}'),
    "json numbers": (JSON_TYPE, b'{"a": [' + b"0," * 3_900_000 + b"0]}"),
    "json texts": (JSON_TYPE, b'{"a": [' + b'"",' * 2_500_000 + b'""]}'),
    "json deep": (JSON_TYPE, b"[" * 8_000_000),
    "msgpack arrays": (MSGPACK_TYPE, b"\x81\xa1a\xdd\x00\x70\x00\x00" + b"\x90" * 0x700000),
    "msgpack objects": (MSGPACK_TYPE, b"\x81\xa1a\xdd\x00\x70\x00\x00" + b"\x80" * 0x700000),
    "msgpack short arrays": (MSGPACK_TYPE, b"\x81\xa1a\xdc\xff\xff" + b"\x90" * 0xFFFF),
    "msgpack short objects": (MSGPACK_TYPE, b"\x81\xa1a\xdc\xff\xff" + b"\x80" * 0xFFFF),
    "msgpack keys": (MSGPACK_TYPE, msgpack.packb({f"k{i}": i for i in range(500_000)})),
    "msgpack claims": (MSGPACK_TYPE, nested_claims(1000, 400_000)),
    "msgpack deep": (MSGPACK_TYPE, b"\x81\xa1a" * 1_000_000),
    "msgpack deep arrays": (MSGPACK_TYPE, b"\x91" * 8_000_000),
}


@pytest.fixture(scope="module")
def api(tmp_path_factory: pytest.TempPathFactory) -> Any:
    made = Api(tmp_path_factory.mktemp("structure"))
    yield made
    made.close()


@pytest.fixture(scope="module")
def survey_id(api: Api) -> str:
    return str(api.ok("POST", "/v1/surveys", json={"level_id": api.level().id, "name": "s"})["id"])


@pytest.mark.timing
@pytest.mark.parametrize("name", BOMBS)
@pytest.mark.parametrize("what", ["segments", "walks"])
def test_a_bomb_is_refused_at_once(api: Api, survey_id: str, name: str, what: str) -> None:
    kind, body = BOMBS[name]
    path = "/v1/sessions/ses_x/segments" if what == "segments" else f"/v1/surveys/{survey_id}/walks"
    sent = gzip.compress(body, 1)
    headers = {"Content-Type": kind, "Content-Encoding": "gzip"}
    seconds = math.inf
    for _ in range(5):  # the best of them: another program may have the processor for a while
        started = time.perf_counter()
        response = api.post(path, content=sent, headers=headers)
        seconds = min(seconds, time.perf_counter() - started)
        if seconds < BOMB_S:
            break
    assert response.status_code == 422, response.text[:200]
    assert len(response.content) < 16_000
    assert all(error["remedy"] for error in response.json()["errors"])
    # measured: up to 0.1 s, with client and event loop set up for the call
    assert seconds < BOMB_S


@pytest.mark.parametrize("name", sorted(BOMBS.keys() - {"json few long keys"}))
def test_a_bomb_takes_little_memory(name: str) -> None:
    kind, body = BOMBS[name]
    tracemalloc.start()
    try:
        with pytest.raises((RejectedError, MalformedBodyError)):
            decode(body, kind, WALK_BOUNDS)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    # A copy of the body is inside the unpacker.
    assert peak < len(body) + 4 * MIB


def test_plain_objects_are_bounded_too(api: Api) -> None:
    for body in (keys(4_000), b"[" + b"[]," * 20_000 + b"[]]"):
        response = api.post("/v1/venues", content=body, headers={"Content-Type": JSON_TYPE})
        assert response.status_code == 422
        assert len(response.content) < 16_000
        assert response.json()["errors"][0]["field"] == "body"


def test_many_findings_are_counted_not_listed(api: Api) -> None:
    problem = api.post("/v1/venues", content=keys(100), headers={"Content-Type": JSON_TYPE}).json()
    assert len(problem["errors"]) == MAX_ERRORS + 1
    assert problem["errors"][-1]["message"] == "and 81 more"  # the name is missing
    assert problem["detail"].endswith("(and 100 more)")


def plan(n_rings: int) -> bytes:
    ring = b"[[0,0],[1,0],[1,1],[0,0]]"
    feature = b'{"type":"Feature","properties":{},"geometry":{"type":"Polygon","coordinates":[%s]}}'
    return b'{"type":"FeatureCollection","features":[' + feature % b",".join([ring] * n_rings) + b"]}"


def test_plans_may_hold_more_and_are_bounded(api: Api) -> None:
    level = api.level()
    for body, status in ((plan(10_000), 204), (plan(60_000), 422), (b"[" + b"[]," * 2_600_000 + b"[]]", 422)):
        response = api.call(
            "PUT", f"/v1/levels/{level.id}/plan.geojson", content=body, headers={"Content-Type": JSON_TYPE}
        )
        assert response.status_code == status, response.text[:300]
    assert "simplify" in response.json()["errors"][0]["remedy"]


def test_the_largest_honest_bodies_pass() -> None:
    for n, bounds in ((20_000, SEGMENT_BOUNDS), (200_000, WALK_BOUNDS)):
        column = [0.125] * n
        vectors = {name: dict.fromkeys("xyz", column) for name in ("mag", "acc", "gyro")}
        wifi = {"t_ms": [1] * 50_000, "bssid": ["a4:2b:8c:00:11:22"] * 50_000, "rssi": [-61] * 50_000}
        ble = {"t_ms": [1] * 50_000, "address": ["c0:ff:ee:00:00:01"] * 50_000, "rssi": [-61] * 50_000}
        others = {
            "gnss": dict.fromkeys(("t_ms", "latitude_deg", "longitude_deg", "accuracy_m"), [1.5] * 10_000),
            "pressure": dict.fromkeys(("t_ms", "hpa"), [950.5] * 10_000),
            "speed": dict.fromkeys(("t_ms", "speed_m_s"), [1.5] * 10_000),
            "steps": dict.fromkeys(("t_ms", "count"), [7] * 10_000),
        }
        aids = {"wifi": wifi, "ble": ble, **others}
        body = {"samples": {"t_ms": column, **vectors}, **aids, "name": "[" * 200}
        check_json(orjson.dumps(body), bounds)
        assert decode_msgpack(msgpack.packb(body), bounds) == body


@pytest.mark.parametrize("part", ["containers", "keys", "strings", "values"])
def test_bounds_are_exact(part: str) -> None:
    bounds = Bounds(**{**dict.fromkeys(("containers", "keys", "strings", "values"), 1000), part: 5}, remedy="less")
    bodies: dict[str, Callable[[int], bytes]] = {
        "containers": lambda n: orjson.dumps([[]] * (n - 1)),
        "keys": lambda n: keys(n),
        "strings": lambda n: orjson.dumps(["x"] * n),
        "values": lambda n: orjson.dumps([1] * (n + 1)),
    }
    check_json(bodies[part](5), bounds)
    with pytest.raises(RejectedError, match="more than 5"):
        check_json(bodies[part](6), bounds)


scalars = (
    st.none() | st.booleans() | st.integers(-(2**63), 2**64 - 1) | st.floats(allow_nan=False) | st.text(max_size=5)
)
values = st.recursive(
    scalars | st.binary(max_size=9) | st.lists(scalars, max_size=5),
    lambda inner: st.dictionaries(st.text(max_size=5), inner, max_size=4),
    max_leaves=5,
)


@given(value=st.dictionaries(st.text(max_size=5), values, max_size=4))
def test_msgpack_is_read_as_the_library_reads_it(value: dict[str, Any]) -> None:
    packed = msgpack.packb(value)
    assert decode_msgpack(packed, OBJECT_BOUNDS) == msgpack.unpackb(packed)


@given(cut=st.integers(0, 60))
def test_cut_msgpack_is_malformed(cut: int) -> None:
    packed = msgpack.packb({"seq": 0, "samples": {"t_ms": [1, 2.5], "mag": b"12345678"}, "frame": "android"})
    with pytest.raises(MalformedBodyError):
        decode_msgpack(packed[: min(cut, len(packed) - 1)], SEGMENT_BOUNDS)


def test_an_array_in_an_array_is_named() -> None:
    for inner in ([], [1], {}, {"a": 1}):
        with pytest.raises(RejectedError) as caught:
            decode_msgpack(msgpack.packb({"samples": {"t_ms": [1, inner]}}), SEGMENT_BOUNDS)
        assert caught.value.errors[0].field == "samples.t_ms"


def test_large_one_shot_requests_are_decoded_few_at_once(api: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    level = api.mapped_level()
    body = segment_body(n=15_000)
    body["samples"]["t_ms"] = body["samples"]["t_ms"][0] + np.arange(15_000) * 2.0
    large = orjson.dumps(plain({"level_id": level.id, "samples": body["samples"]}))
    assert len(large) > LARGE_BYTES
    running, most, lock = 0, 0, threading.Lock()

    def counted(*arguments: Any) -> Any:
        nonlocal running, most
        with lock:
            running += 1
            most = max(most, running)
        try:
            return parse(*arguments)
        finally:
            with lock:
                running -= 1

    monkeypatch.setattr(locate_router, "parse", counted)

    async def scene() -> list[int]:
        calls = [api.acall("POST", "/v1/locate", content=large, headers={"Content-Type": JSON_TYPE}) for _ in range(10)]
        return [response.status_code for response in await asyncio.gather(*calls)]

    assert asyncio.run(scene()) == [200] * 10
    assert 1 <= most <= 2
