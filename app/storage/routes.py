"""The survey lines of a map as one compressed, content-hashed blob.

A fixed header (magic, version, number of points and of lines) and one zlib stream: the first points' indices (int32)
and the points (float32), little-endian. The hash covers the uncompressed values.
"""

from __future__ import annotations

import hashlib
import struct
import zlib

import numpy as np

from app.engine.errors import MapError
from app.engine.types import RouteLines
from app.services.records import PackedLayer

_PREFIX = struct.Struct("<2sBII")
_MAGIC = b"IL"
_VERSION = 1
_LEVEL = 6


def pack_routes(routes: RouteLines) -> PackedLayer:
    """Compress and hash lines; MapError if their indices do not fit their points."""
    xy = np.ascontiguousarray(routes.xy, dtype="<f4")
    first = np.ascontiguousarray(routes.first, dtype="<i4")
    _check(xy.shape, first)
    head = _PREFIX.pack(_MAGIC, _VERSION, len(xy), len(first))
    values = first.tobytes() + xy.tobytes()
    return PackedLayer(hashlib.sha256(head + values).hexdigest(), head + zlib.compress(values, _LEVEL))


def unpack_routes(data: bytes) -> RouteLines:
    """Inverse of :func:`pack_routes`; MapError if the blob is damaged or of another version."""
    if len(data) < _PREFIX.size:
        raise MapError("the lines of the map are shorter than their header")
    magic, version, points, lines = _PREFIX.unpack_from(data)
    if (magic, version) != (_MAGIC, _VERSION):
        raise MapError(f"lines {magic!r} of version {version} are not {_MAGIC!r} {_VERSION}")
    try:
        values = zlib.decompress(memoryview(data)[_PREFIX.size :])
    except zlib.error as error:
        raise MapError(f"damaged lines of the map: {error}") from error
    if len(values) != 4 * lines + 8 * points:
        raise MapError(f"{len(values)} bytes are not {lines} lines of {points} points")
    first = np.frombuffer(values, dtype="<i4", count=lines)
    xy = np.frombuffer(values, dtype="<f4", offset=4 * lines).reshape(points, 2)
    _check(xy.shape, first)
    return RouteLines(xy.astype(np.float32, copy=False), first.astype(np.int32, copy=False))


def _check(shape: tuple[int, ...], first: np.ndarray[tuple[int], np.dtype[np.int32]]) -> None:
    ordered = len(first) > 0 and first[0] == 0 and bool(np.all(np.diff(first) > 0)) and first[-1] < shape[0]
    if len(shape) != 2 or shape[1] != 2 or not ordered:
        raise MapError(f"lines that begin at {first[:5].tolist()} do not fit points of shape {shape}")
