"""Bounds on the structure of a body, checked before or while it is decoded.

A few bytes can stand for objects of a hundred times the size (``[],[],...``), so a bound on bytes alone does not
bound time and memory. No honest upload comes near these bounds: it is few objects with long columns.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from typing import Any

import msgpack

from app.api.errors import MalformedBodyError, RejectedError
from app.api.validation import FieldError

_KEY = re.compile(rb'"[ \t\r\n]*+:')
_MAX_DEPTH = 8


@dataclass(frozen=True, slots=True)
class Bounds:
    """What one body may hold at most."""

    containers: int
    """Arrays and objects."""
    keys: int
    strings: int
    """Keys and texts."""
    values: int
    remedy: str


OBJECT_BOUNDS = Bounds(256, 256, 2_000, 4_000, "send one object with the fields that /docs shows")
SEGMENT_BOUNDS = Bounds(256, 256, 120_000, 750_000, "send columns of at most 20000 samples; /docs shows the fields")
WALK_BOUNDS = Bounds(256, 256, 120_000, 2_500_000, "send columns of at most 200000 samples; /docs shows the fields")
PLAN_BOUNDS = Bounds(200_000, 200_000, 400_000, 1_000_000, "simplify the plan, or leave features out")


def check_json(body: bytes, bounds: Bounds) -> None:
    """Refuse JSON of too many parts without parsing it.

    Punctuation inside texts counts too: names and addresses are far too short to matter.
    """
    _at_most(body.count(b"[") + body.count(b"{"), bounds.containers, "arrays and objects", bounds)
    _at_most(body.count(b","), bounds.values, "values", bounds)
    _at_most(body.count(b'"') // 2, bounds.strings, "texts", bounds)
    # Counted last and only so far: the bound on texts keeps the search short.
    _at_most(sum(1 for _ in islice(_KEY.finditer(body), bounds.keys + 1)), bounds.keys, "fields", bounds)


def decode_msgpack(body: bytes, bounds: Bounds) -> Any:
    """Decode msgpack to plain values: objects of few fields, and arrays of scalars."""
    try:
        return _MsgpackReader(body, bounds).read_all()
    except (ValueError, msgpack.UnpackException) as error:
        detail = str(error) or type(error).__name__
        raise MalformedBodyError(f"the body is not valid msgpack: {detail}") from error


def _at_most(count: int, bound: int, what: str, bounds: Bounds) -> None:
    if count > bound:
        raise RejectedError([FieldError("body", f"holds more than {bound} {what}", bounds.remedy)])


class _MsgpackReader:
    """Walks objects field by field, so that depth and number are known before anything is allocated for them.

    The unpacker itself may build scalars only. It reserves memory for an array by the length that the array
    claims; nested claims would add up to gigabytes from a few kilobytes.
    """

    def __init__(self, body: bytes, bounds: Bounds) -> None:
        self._body = body
        self._bounds = bounds
        self._containers = self._keys = self._values = 0
        self._unpacker = msgpack.Unpacker(
            max_buffer_size=max(len(body), 1),
            raw=False,
            max_array_len=0,
            max_map_len=0,
            list_hook=self._nested,
            object_hook=self._nested,
        )
        self._unpacker.feed(body)

    def read_all(self) -> Any:
        """Read the one value of the body."""
        value = self._value("", 0)
        if self._unpacker.tell() != len(self._body):
            raise ValueError("something follows the first value")
        return value

    def _value(self, path: str, depth: int) -> Any:
        at = self._unpacker.tell()
        lead = self._body[at] if at < len(self._body) else 0xC0
        if 0x80 <= lead <= 0x8F or lead in (0xDE, 0xDF):
            return self._object(path, depth)
        if 0x90 <= lead <= 0x9F or lead in (0xDC, 0xDD):
            return self._array(path)
        return self._unpacker.unpack()

    def _object(self, path: str, depth: int) -> dict[str, Any]:
        if depth >= _MAX_DEPTH:
            raise RejectedError([FieldError(path or "body", "is nested too deeply", self._bounds.remedy)])
        self._count_container()
        n = self._unpacker.read_map_header()
        self._keys += n
        _at_most(self._keys, self._bounds.keys, "fields", self._bounds)
        return dict(self._fields(n, path, depth))

    def _fields(self, n: int, path: str, depth: int) -> Iterator[tuple[str, Any]]:
        for _ in range(n):
            key = self._unpacker.unpack()
            if not isinstance(key, str):
                raise MalformedBodyError(f"the body is not taken: a key is of type {type(key).__name__}, not a text")
            yield key, self._value(f"{path}.{key[:64]}" if path else key[:64], depth + 1)

    def _array(self, path: str) -> list[Any]:
        self._count_container()
        n = self._unpacker.read_array_header()
        self._values += n
        _at_most(self._values, self._bounds.values, "values", self._bounds)
        try:
            values = list(islice(self._unpacker, n))
        except ValueError as error:
            if "exceeds max_" not in str(error):
                raise
            raise _nested_in(path or "body") from error
        except _NestedError as error:
            raise _nested_in(path or "body") from error
        if len(values) < n:
            raise ValueError("the data end early")
        return values

    def _count_container(self) -> None:
        self._containers += 1
        _at_most(self._containers, self._bounds.containers, "arrays and objects", self._bounds)

    @staticmethod
    def _nested(_: object) -> Any:
        raise _NestedError


class _NestedError(Exception):
    """An array holds an array or an object."""


def _nested_in(path: str) -> RejectedError:
    return RejectedError([FieldError(path, "holds an array or an object", "send an array of numbers or of texts")])
