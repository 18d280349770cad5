"""Reading bodies: sizes, encodings, formats."""

from __future__ import annotations

import asyncio
import gzip
import json
import tracemalloc
import zlib
from collections.abc import AsyncIterator, Callable
from typing import Any

import msgpack
import pytest
from starlette.types import Message

from app.api.body import INFLATE_RATIO, SEGMENT_BYTES, decode, inflate
from app.api.errors import BodyTooLargeError, MalformedBodyError
from app.api.structure import SEGMENT_BOUNDS
from app.services.records import Scope
from tests.api.harness import Api, as_msgpack, packed, plain, segment_body

MIB = 2**20
ENDLESS = 100 * MIB


class Upload:
    """An ASGI client that sends ``size`` bytes in chunks and counts what is taken of them."""

    def __init__(self, size: int, chunk: int = 64 * 1024) -> None:
        self.left, self.chunk, self.taken = size, chunk, 0
        self.answer: dict[str, Any] = {}

    async def receive(self) -> Message:
        piece = min(self.chunk, self.left)
        self.left -= piece
        self.taken += piece
        return {"type": "http.request", "body": b"0" * piece, "more_body": self.left > 0}

    async def send(self, message: Message) -> None:
        if message["type"] == "http.response.start":
            self.answer = {"status": message["status"], "headers": dict(message["headers"])}


def send(api: Api, upload: Upload, path: str, *, announced: bool) -> dict[str, Any]:
    headers = [
        (b"content-type", b"application/json"),
        (b"x-api-key", api.secrets[Scope.ADMIN].encode()),
        *([(b"content-length", str(upload.left).encode())] if announced else []),
    ]
    scope = {
        "type": "http",
        "asgi": {"version": "3.0"},
        "http_version": "1.1",
        "method": "POST",
        "scheme": "http",
        "path": path,
        "raw_path": path.encode(),
        "query_string": b"",
        "root_path": "",
        "headers": headers,
        "client": ("127.0.0.1", 1),
        "server": ("isodyn.test", 80),
    }
    asyncio.run(api.app(scope, upload.receive, upload.send))
    return upload.answer


PATHS = ["/v1/sessions/ses_x/segments", "/v1/surveys/srv_x/walks", "/v1/locate", "/v1/venues"]


@pytest.mark.parametrize("path", PATHS)
def test_a_body_that_announces_100_mb_is_not_read_at_all(api: Api, path: str) -> None:
    upload = Upload(ENDLESS)
    answer = send(api, upload, path, announced=True)
    assert answer["status"] == 413
    assert answer["headers"][b"connection"] == b"close"
    assert upload.taken == 0


@pytest.mark.parametrize("path", PATHS)
def test_a_body_that_never_ends_is_left_at_the_limit(api: Api, path: str) -> None:
    upload = Upload(ENDLESS)
    assert send(api, upload, path, announced=False)["status"] == 413
    assert upload.taken <= 8 * MIB + upload.chunk


def test_without_a_key_nothing_is_read(api: Api) -> None:
    upload = Upload(ENDLESS)
    api.secrets[Scope.ADMIN] = "isk_unknown"
    assert send(api, upload, "/v1/locate", announced=False)["status"] == 401
    assert upload.taken == 0


def test_the_limit_is_a_setting(make_api: Callable[..., Api]) -> None:
    api = make_api(max_body_bytes=4096)
    session_id = api.session_id()
    refused = api.post(f"/v1/sessions/{session_id}/segments", json=plain(segment_body()))
    assert refused.status_code == 413
    assert "4096" in refused.json()["detail"]
    assert api.stored()["segments"] == 0


def gzipped(call: dict[str, Any]) -> dict[str, Any]:
    return {
        "content": gzip.compress(call["content"]),
        "headers": {**call["headers"], "Content-Encoding": "gzip"},
    }


def test_gzip_is_taken(api: Api) -> None:
    session_id = api.session_id()
    path = f"/v1/sessions/{session_id}/segments"
    assert api.post(path, **gzipped(as_msgpack(segment_body()))).status_code in (200, 202)
    text = {"content": json.dumps(plain(segment_body())).encode(), "headers": {"Content-Type": "application/json"}}
    assert api.post(path, **gzipped(text)).headers["Isodyn-Repeated"] == "true"


def test_gzip_is_taken_for_plain_objects(api: Api) -> None:
    text = {"content": b'{"name": "Mall"}', "headers": {"Content-Type": "application/json"}}
    assert api.post("/v1/venues", **gzipped(text)).status_code == 201


def test_a_gzip_bomb_is_refused(make_api: Callable[..., Api]) -> None:
    api = make_api(max_body_bytes=MIB)
    bomb = gzip.compress(b"0" * (200 * MIB), compresslevel=9)
    assert len(bomb) < MIB
    headers = {"Content-Type": "application/json", "Content-Encoding": "gzip"}
    for path in PATHS:
        response = api.post(path, content=bomb, headers=headers)
        assert response.status_code == 413, path


def test_a_gzip_bomb_never_unfolds_in_memory() -> None:
    bomb = gzip.compress(b"\0" * (64 * MIB), compresslevel=9)
    limit = 2 * MIB
    tracemalloc.start()
    with pytest.raises(BodyTooLargeError):
        inflate(bomb, limit)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 2 * limit


@pytest.mark.parametrize("size", [0, 1, 255, 256 * 1024, 256 * 1024 + 1, MIB])
def test_inflate_gives_back_what_was_compressed(size: int) -> None:
    body = bytes(i % 251 for i in range(size))
    assert inflate(gzip.compress(body), MIB) == body


def test_inflate_stops_one_byte_above_the_limit() -> None:
    with pytest.raises(BodyTooLargeError):
        inflate(gzip.compress(b"x" * 1001), 1000)


@pytest.mark.parametrize(
    "body",
    [b"", b"not gzip", gzip.compress(b"x" * 1000)[:-9], gzip.compress(b"x") + b"tail", zlib.compress(b"x")],
    ids=["nothing", "no gzip", "cut", "with a tail", "zlib"],  # a gzip header holds the time: no name for a test
)
def test_damaged_gzip_is_malformed(body: bytes) -> None:
    with pytest.raises(MalformedBodyError):
        inflate(body, MIB)


def test_other_encodings_are_refused(api: Api) -> None:
    response = api.post(
        "/v1/venues", content=b"x", headers={"Content-Type": "application/json", "Content-Encoding": "br"}
    )
    assert response.status_code == 415
    assert response.headers["Accept-Encoding"] == "gzip"


@pytest.mark.parametrize("kind", ["text/plain", "application/xml", "multipart/form-data; boundary=x", ""])
def test_other_types_are_refused(api: Api, kind: str) -> None:
    session_id = api.session_id()
    for path in (f"/v1/sessions/{session_id}/segments", "/v1/venues"):
        response = api.post(path, content=b"{}", headers={"Content-Type": kind})
        assert response.status_code == 415
        assert "application/json" in response.headers["Accept"]
        assert "application/json" in response.json()["detail"]


@pytest.mark.parametrize("kind", ["application/json; charset=utf-8", "Application/JSON", "application/vnd.isodyn+json"])
def test_json_by_any_name(api: Api, kind: str) -> None:
    assert api.post("/v1/venues", content=b'{"name": "x"}', headers={"Content-Type": kind}).status_code == 201


def test_msgpack_by_its_registered_name(api: Api) -> None:
    call = as_msgpack(segment_body())
    response = api.post(
        f"/v1/sessions/{api.session_id()}/segments",
        content=call["content"],
        headers={"Content-Type": "application/vnd.msgpack"},
    )
    assert response.is_success


MALFORMED_JSON = [
    b"",
    b"{",
    b'{"a": 1,}',
    b"{'a': 1}",
    b'{"a": NaN',
    b"\xff\xfe",
    b'{"a": "\\ud800"}',
    b"[" * 250,
    b'{"a":' * 250,
    b"\x00",
]


@pytest.mark.parametrize("body", MALFORMED_JSON, ids=range(len(MALFORMED_JSON)))
def test_malformed_json(api: Api, body: bytes) -> None:
    before = api.stored()
    for path in ("/v1/locate", f"/v1/levels/{api.level().id}/plan.geojson"):
        method = "PUT" if path.endswith("geojson") else "POST"
        response = api.call(method, path, content=body, headers={"Content-Type": "application/json"})
        assert response.status_code == 400, path
        problem = response.json()
        assert problem["type"].endswith("/malformed-body")
        assert "not valid JSON" in problem["detail"]
    assert api.stored() == {**before, "venues": before["venues"] + 1, "levels": before["levels"] + 1}


MALFORMED_MSGPACK = [
    b"",
    b"\xc1",
    b"\x81",
    b"\xdf\x00\x00\x00\xff",
    b"\xdd\x00\x00\xff\xff\x01",
    b"\xc6\xff\xff\xff\xff",
    b"\x81\x01\x02",
    b"\x81\xa1a",
    b"\x92\x01",
    b"\xa2\xff\xfe",
    msgpack.packb({"seq": 0}) + b"\x00",
]


@pytest.mark.parametrize("body", MALFORMED_MSGPACK, ids=range(len(MALFORMED_MSGPACK)))
def test_malformed_msgpack(api: Api, body: bytes) -> None:
    response = api.post("/v1/locate", content=body, headers={"Content-Type": "application/msgpack"})
    assert response.status_code == 400
    assert response.json()["type"].endswith("/malformed-body")


@pytest.mark.parametrize("value", [None, 1, "x", [], [1], msgpack.Timestamp(1), msgpack.ExtType(4, b"x")])
def test_a_body_that_is_no_object(api: Api, value: object) -> None:
    response = api.post("/v1/locate", content=msgpack.packb(value), headers={"Content-Type": "application/msgpack"})
    assert response.status_code == 422
    (error,) = response.json()["errors"]
    assert (error["field"], error["message"]) == ("body", "is not an object")


def test_only_non_finite_numbers_come_through() -> None:
    lenient = decode(b'{"a": [NaN, -Infinity, 1e999]}', "application/json", SEGMENT_BOUNDS)
    assert lenient["a"][1:] == [float("-inf"), float("inf")]
    assert decode(b'{"a": 1e999}', "application/json", SEGMENT_BOUNDS) == {"a": float("inf")}
    for body in (b'{"a": nan}', b'{"a": 01}', b'{"a": NaN} x'):
        with pytest.raises(MalformedBodyError):
            decode(body, "application/json", SEGMENT_BOUNDS)


def test_a_client_that_goes_away_is_no_failure_of_the_service(api: Api) -> None:
    class Leaving(Upload):
        async def receive(self) -> Message:
            return {"type": "http.disconnect"}

    assert send(api, Leaving(10), "/v1/locate", announced=False)["status"] == 400


def test_chunks_are_put_together(api: Api) -> None:
    body = msgpack.packb(packed(segment_body()))

    async def pieces() -> AsyncIterator[bytes]:
        for start in range(0, len(body), 1000):
            yield body[start : start + 1000]

    path = f"/v1/sessions/{api.session_id()}/segments"
    response = api.post(path, content=pieces(), headers={"Content-Type": "application/msgpack"})
    assert response.is_success


def test_walks_may_inflate_further_than_segments(api: Api) -> None:
    assert INFLATE_RATIO > 1
    body = gzip.compress(b" " * (SEGMENT_BYTES + 1))
    headers = {"Content-Type": "application/json", "Content-Encoding": "gzip"}
    survey_id = api.ok("POST", "/v1/surveys", json={"level_id": api.level().id, "name": "s"})["id"]
    for path, status in (
        ("/v1/sessions/ses_x/segments", 413),
        ("/v1/locate", 413),
        (f"/v1/surveys/{survey_id}/walks", 400),
    ):
        assert api.post(path, content=body, headers=headers).status_code == status, path
