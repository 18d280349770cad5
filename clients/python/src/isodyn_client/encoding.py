"""Bodies of uploads: msgpack with raw little-endian columns (the fast path) or JSON, plain or gzipped.

A body is kept as parts (ready bytes, and columns that are still numpy arrays) and encoded piece by piece
while it is sent, so that a long walk never exists twice in memory. A body can be sent any number of times.
"""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import msgpack
import numpy as np
from numpy.typing import NDArray

from isodyn_client.aids import NO_AIDS, Aids
from isodyn_client.samples import Samples, Waypoints

_PIECE = 16_384
"""Rows of a column that are encoded at a time."""
_BIN32 = b"\xc6"
_AXES = ("x", "y", "z")


class Encoding(StrEnum):
    """How samples travel."""

    MSGPACK = "msgpack"
    JSON = "json"


@dataclass(frozen=True, slots=True)
class Column:
    """A numeric column that is encoded when its turn comes: shape (n,), ``dtype`` on the wire."""

    values: NDArray[np.float64]
    dtype: str

    @property
    def n_bytes(self) -> int:
        """Length on the wire."""
        return len(self.values) * np.dtype(self.dtype).itemsize

    def chunks(self) -> Iterator[bytes]:
        """Encoded pieces, in order."""
        for start in range(0, len(self.values), _PIECE):
            yield self.values[start : start + _PIECE].astype(self.dtype).tobytes()


@dataclass(frozen=True, slots=True)
class Body:
    """A request body that can be sent again.

    ``chunks()`` starts afresh every time. ``headers`` carry type, coding and, where it is known beforehand,
    length (so that the service can refuse a body that is too long before reading it).
    """

    content_type: str
    parts: tuple[bytes | Column, ...]
    gzip: bool = False

    @property
    def headers(self) -> dict[str, str]:
        """Headers that describe the body."""
        if self.gzip:
            return {"Content-Type": self.content_type, "Content-Encoding": "gzip"}
        length = sum(part.n_bytes if isinstance(part, Column) else len(part) for part in self.parts)
        return {"Content-Type": self.content_type, "Content-Length": str(length)}

    def chunks(self) -> Iterator[bytes]:
        """The encoded body, piece by piece."""
        return _gzipped(self._plain()) if self.gzip else self._plain()

    def _plain(self) -> Iterator[bytes]:
        for part in self.parts:
            if isinstance(part, Column):
                yield from part.chunks()
            else:
                yield part


def json_body(value: Mapping[str, Any]) -> Body:
    """A small JSON object."""
    return Body("application/json", (json.dumps(value, separators=(",", ":")).encode(),))


def raw_body(content: bytes, content_type: str, *, gzip: bool = False) -> Body:
    """Bytes that are already encoded: a PNG, a GeoJSON file."""
    return Body(content_type, (content,), gzip)


def samples_body(
    fields: Mapping[str, Any],
    samples: Samples,
    *,
    aids: Aids | None = None,
    waypoints: Waypoints | None = None,
    encoding: Encoding | str = Encoding.MSGPACK,
    gzip: bool = False,
) -> Body:
    """Samples with what belongs to them, beside the plain ``fields`` of the call."""
    value: dict[str, Any] = {**fields, "frame": samples.frame, "samples": _columns(samples)}
    value.update((aids or NO_AIDS).columns())
    if waypoints is not None:
        value["waypoints"] = {name: getattr(waypoints, name).tolist() for name in ("t_ms", "x", "y")}
    if Encoding(encoding) is Encoding.JSON:
        text = json.dumps(value, default=_as_list, separators=(",", ":"))
        return Body("application/json", (text.encode(),), gzip)
    return Body("application/msgpack", tuple(_joined(_packed(value))), gzip)


def _columns(samples: Samples) -> dict[str, Any]:
    triples = {
        name: {axis: Column(getattr(samples, name)[:, i], "<f4") for i, axis in enumerate(_AXES)}
        for name in ("mag", "acc", "gyro")
    }
    return {"t_ms": Column(samples.t_ms, "<f8"), **triples}


def _as_list(value: object) -> list[float]:
    if isinstance(value, Column):
        numbers: list[float] = value.values.tolist()
        return numbers
    raise TypeError(f"cannot encode {type(value).__name__}")


def _packed(value: object) -> Iterator[bytes | Column]:
    """msgpack, with columns left as they are behind the header of their bin."""
    if isinstance(value, Column):
        yield _BIN32 + struct.pack(">I", value.n_bytes)
        yield value
    elif isinstance(value, Mapping):
        yield msgpack.Packer().pack_map_header(len(value))
        for key, item in value.items():
            yield msgpack.packb(key)
            yield from _packed(item)
    else:
        yield msgpack.packb(value)


def _joined(parts: Iterator[bytes | Column]) -> Iterator[bytes | Column]:
    """Neighbouring bytes as one part: a handful of writes a body, not hundreds."""
    pending: list[bytes] = []
    for part in parts:
        if isinstance(part, bytes):
            pending.append(part)
            continue
        yield b"".join(pending)
        pending.clear()
        yield part
    if pending:
        yield b"".join(pending)


def _gzipped(pieces: Iterator[bytes]) -> Iterator[bytes]:
    # wbits 31: a gzip header and trailer around the deflate stream. Level 1: the columns are noise in their low
    # bits, higher levels only cost time.
    deflate = zlib.compressobj(level=1, wbits=31)
    for piece in pieces:
        if packed := deflate.compress(piece):
            yield packed
    yield deflate.flush()
