"""The radio layer of a map as one compressed, content-hashed blob, and as one array in the map cache.

The blob is a fixed header (magic, version, length of the description), the description (JSON: grid and addresses) and
one zlib stream of the three arrays, transmitter by transmitter. The hash covers description and *uncompressed* values,
so equal layers have one hash whatever zlib packed them. A layer is stored once, however many map versions have it.
"""

from __future__ import annotations

import hashlib
import json
import struct
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from app.engine.errors import MapError
from app.engine.types import RadioMap, UInt8Array
from app.services.records import PackedLayer

_PREFIX = struct.Struct("<2sBI")
_MAGIC = b"IR"
_VERSION = 1
_LEVEL = 1  # the next levels save a few per cent and take several times as long
_LAYERS = 3


@dataclass(frozen=True, slots=True)
class RadioHeader:
    """What of a :class:`RadioMap` is not its arrays."""

    x0: float
    y0: float
    cell_m: float
    rows: int
    columns: int
    addresses: tuple[str, ...]

    @property
    def shape(self) -> tuple[int, int, int, int]:
        """Shape of the stacked layers: mean, sd and seen; transmitters; rows; columns."""
        return _LAYERS, len(self.addresses), self.rows, self.columns

    def to_json(self) -> str:
        """Stable text: equal headers give equal text."""
        return json.dumps(self.values(), sort_keys=True)

    def values(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {name: getattr(self, name) for name in self.__slots__}

    @classmethod
    def from_json(cls, text: str) -> RadioHeader:
        """Inverse of :meth:`to_json`."""
        return cls.from_values(json.loads(text))

    @classmethod
    def from_values(cls, values: Mapping[str, Any]) -> RadioHeader:
        """Inverse of :meth:`values`, also after JSON, where tuples come back as lists."""
        return cls(**{**values, "addresses": tuple(values["addresses"])})


def radio_header_of(radio: RadioMap) -> RadioHeader:
    """Header of a radio layer; MapError if its arrays do not fit together."""
    expected = (len(radio.addresses), *radio.mean.shape[1:])
    kinds = {"mean": np.int8, "sd": np.uint8, "seen": np.uint8}
    for name, kind in kinds.items():
        array = getattr(radio, name)
        if array.ndim != 3 or array.shape != expected or array.dtype != kind:
            raise MapError(f"radio {name} of shape {array.shape} and type {array.dtype} does not fit {expected}")
    _, rows, columns = expected
    return RadioHeader(
        float(radio.x0), float(radio.y0), float(radio.cell_m), rows, columns, tuple(map(str, radio.addresses))
    )


def stack_radio(radio: RadioMap) -> UInt8Array:
    """The three arrays as one of bytes, shape (3, transmitters, rows, columns)."""
    return np.stack([np.ascontiguousarray(radio.mean).view(np.uint8), radio.sd, radio.seen])


def split_radio(header: RadioHeader, layers: UInt8Array) -> RadioMap:
    """Inverse of :func:`stack_radio`; the arrays are views."""
    if layers.shape != header.shape or layers.dtype != np.uint8:
        raise MapError(f"radio layers of shape {layers.shape} do not fit {header.shape}")
    return RadioMap(
        x0=header.x0,
        y0=header.y0,
        cell_m=header.cell_m,
        addresses=header.addresses,
        mean=layers[0].view(np.int8),
        sd=layers[1],
        seen=layers[2],
    )


def pack_radio(radio: RadioMap) -> PackedLayer:
    """Compress and hash a radio layer."""
    description = radio_header_of(radio).to_json().encode()
    head = _PREFIX.pack(_MAGIC, _VERSION, len(description)) + description
    values = stack_radio(radio).data
    digest = hashlib.sha256(head)
    digest.update(values)
    return PackedLayer(digest.hexdigest(), head + zlib.compress(values, _LEVEL))


def unpack_radio(data: bytes) -> RadioMap:
    """Inverse of :func:`pack_radio`; MapError if the blob is damaged or of another version."""
    if len(data) < _PREFIX.size:
        raise MapError("the radio layer is shorter than its header")
    magic, version, length = _PREFIX.unpack_from(data)
    if (magic, version) != (_MAGIC, _VERSION):
        raise MapError(f"a radio layer {magic!r} of version {version} is not {_MAGIC!r} {_VERSION}")
    start = _PREFIX.size + length
    try:
        header = RadioHeader.from_json(data[_PREFIX.size : start].decode())
        values = np.frombuffer(zlib.decompress(memoryview(data)[start:]), dtype=np.uint8)
    except (ValueError, TypeError, KeyError, zlib.error) as error:
        raise MapError(f"damaged radio layer: {error}") from error
    if values.size != int(np.prod(header.shape)):
        raise MapError(f"a radio layer of {values.size} bytes does not have the shape {header.shape}")
    return split_radio(header, values.reshape(header.shape))
