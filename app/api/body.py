"""Reading bodies: bounded, inflated within bounds, decoded from JSON or msgpack.

Nothing here looks at what a body means; :mod:`app.api.uploads` does.
"""

from __future__ import annotations

import json
import zlib
from typing import Any

import orjson
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request

from app.api.errors import BodyTooLargeError, MalformedBodyError, MediaTypeError
from app.api.structure import OBJECT_BOUNDS, Bounds, check_json, decode_msgpack

JSON = "application/json"
MSGPACK = "application/msgpack"
MSGPACK_REGISTERED = "application/vnd.msgpack"
UPLOAD_TYPES = (JSON, MSGPACK, MSGPACK_REGISTERED)
"""Media types of samples."""

INFLATE_RATIO = 4
"""A compressed body may inflate to this many times the largest body as sent."""
SEGMENT_BYTES = 8 * 2**20
"""Largest segment or one-shot request, inflated: 20,000 samples are about 4 MB of JSON."""
_CHUNK = 256 * 1024


def media_type(request: Request) -> str:
    """Return the body's media type, lower case, without parameters."""
    return request.headers.get("content-type", "").partition(";")[0].strip().lower()


def is_json(kind: str) -> bool:
    """Whether a media type is JSON or built on it."""
    return kind == JSON or (kind.startswith("application/") and kind.endswith("+json"))


def require_media_type(request: Request, *accepted: str) -> str:
    """Return the body's media type; MediaTypeError if it is none of ``accepted`` (``application/json``: any JSON)."""
    kind = media_type(request)
    for name in accepted:
        if kind == name or (name == JSON and is_json(kind)):
            return name
    given = f"is {kind[:100]!r}" if kind else "is missing"
    raise MediaTypeError(f"Content-Type {given}; send one of: {', '.join(accepted)}", accept=", ".join(accepted))


async def read_body(request: Request, limit: int, *, inflated: int | None = None) -> bytes:
    """Read at most ``limit`` bytes as sent, inflated to at most ``INFLATE_RATIO`` times as many (or ``inflated``).

    A body that announces more is refused before any of it is read; one that does not say its length, at the
    chunk that exceeds the limit.
    """
    most = limit * INFLATE_RATIO if inflated is None else min(inflated, limit * INFLATE_RATIO)
    limit = min(limit, most)
    encoding = request.headers.get("content-encoding", "identity").strip().lower()
    if encoding not in {"identity", "gzip"}:
        raise MediaTypeError(
            f"Content-Encoding {encoding[:100]!r} is not taken; send gzip or none", accept_encoding="gzip"
        )
    announced = request.headers.get("content-length", "")
    if announced.isdigit() and int(announced) > limit:
        raise BodyTooLargeError(f"the body has {announced} bytes; at most {limit} are taken: send smaller pieces")
    chunks: list[bytes] = []
    size = 0
    async for chunk in request.stream():
        size += len(chunk)
        if size > limit:
            raise BodyTooLargeError(f"the body has more than the {limit} bytes that are taken: send smaller pieces")
        chunks.append(chunk)
    body = b"".join(chunks)
    if encoding == "identity":
        return body
    # In a thread: the largest body takes a tenth of a second, in which the loop would answer nobody.
    return await run_in_threadpool(inflate, body, most)


def inflate(body: bytes, limit: int) -> bytes:
    """Inflate gzip data to at most ``limit`` bytes; nothing beyond is ever held in memory."""
    parts: list[bytes] = []
    size = 0
    inflater = zlib.decompressobj(wbits=31)
    pending = body
    try:
        while not inflater.eof:
            part = inflater.decompress(pending, _CHUNK)
            pending = inflater.unconsumed_tail
            if not part and not pending and not inflater.eof:
                raise MalformedBodyError("the gzip data end early; send the whole body")
            size += len(part)
            if size > limit:
                raise BodyTooLargeError(f"the body inflates to more than {limit} bytes: send smaller pieces")
            parts.append(part)
    except zlib.error as error:
        raise MalformedBodyError(f"the body is not valid gzip ({error}); check Content-Encoding") from error
    if inflater.unused_data:
        raise MalformedBodyError("something follows the gzip data; send a single gzip member")
    return b"".join(parts)


def decode(body: bytes, kind: str, bounds: Bounds) -> Any:
    """Decode a body of media type ``kind`` (JSON or msgpack) to plain Python values, within bounds."""
    if kind in {MSGPACK, MSGPACK_REGISTERED}:
        return decode_msgpack(body, bounds)
    return decode_json(body, bounds)


def decode_json(body: bytes, bounds: Bounds = OBJECT_BOUNDS, *, non_finite: bool = True) -> Any:
    """Decode JSON strictly, within bounds; only NaN and infinities come through, to be named (``non_finite``).

    Those are what ``json.dumps`` of several languages writes for a missing reading: a position in the text would
    not help the caller, the field's name does.
    """
    check_json(body, bounds)
    try:
        return orjson.loads(body)
    except orjson.JSONDecodeError as error:
        lenient = _with_non_finite(body, overflow="infinity" in error.msg) if non_finite else None
        if lenient is None:
            where = f"line {error.lineno} column {error.colno}"
            raise MalformedBodyError(f"the body is not valid JSON: {error.msg} ({where})") from error
        return lenient


def _with_non_finite(body: bytes, *, overflow: bool) -> Any:
    """Decode with NaN, Infinity and (``overflow``) numbers like 1e999; None if that is not what was wrong."""
    seen: list[str] = []

    def constant(name: str) -> float:
        seen.append(name)
        return float(name)

    try:
        value = json.loads(body, parse_constant=constant)
    except (ValueError, RecursionError):
        return None
    return value if seen or overflow else None
