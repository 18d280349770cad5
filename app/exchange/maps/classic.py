"""Reader of netCDF classic files (CDF-1 and CDF-2), bounded: every count is checked against the bytes that are there.

Written from the format's grammar (netCDF user guide, "File Format Specifications": netCDF classic), so that a damaged
or hostile file ends in an :class:`InputError` and never in a large allocation. Record variables (an unlimited
dimension) are not read: a grid has none.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from app.engine.errors import InputError

_HDF5 = b"\x89HDF\r\n\x1a\n"
_DIMENSION, _VARIABLE, _ATTRIBUTE = 10, 11, 12
_CHAR = 2
_TYPES: Mapping[int, str] = {1: ">i1", 3: ">i2", 4: ">i4", 5: ">f4", 6: ">f8"}
_MAX_ITEMS = 1000
"""Dimensions, variables or attributes of one list; a grid has a few dozen."""
_MAX_NAME = 256
_REMEDY = "send a whole netCDF classic file"

Attribute = str | tuple[float, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Variable:
    """One variable: names of its dimensions, values of that shape, attributes."""

    dimensions: tuple[str, ...]
    values: NDArray[Any]
    attributes: Mapping[str, Attribute]


@dataclass(frozen=True, slots=True, eq=False)
class Dataset:
    """What a file holds."""

    variables: Mapping[str, Variable]
    attributes: Mapping[str, Attribute]


def read_classic(content: bytes) -> Dataset:
    """Read a file.

    Raises
    ------
    InputError
        It is not netCDF classic, is cut short or damaged, or has a record dimension.
    """
    if content.startswith(_HDF5):
        raise InputError(
            "file", "is netCDF-4 (HDF5); only the classic format is read: nccopy -k classic FILE classic.nc"
        )
    if content[:3] != b"CDF" or content[3:4] not in {b"\x01", b"\x02"}:
        raise InputError("file", f"does not begin like netCDF; {_REMEDY}")
    return _Reader(content, wide_offsets=content[3:4] == b"\x02").dataset()


class _Reader:
    """Goes through the header from front to back."""

    def __init__(self, content: bytes, *, wide_offsets: bool) -> None:
        self._content = content
        self._at = 4
        self._offset = ">q" if wide_offsets else ">i"

    def dataset(self) -> Dataset:
        records = self._integer()
        dimensions = self._dimensions()
        attributes = self._attributes()
        count = self._list(_VARIABLE)
        variables = dict(self._variable(dimensions) for _ in range(count))
        if records > 0:
            raise InputError("file", "has an unlimited dimension with records; save it with fixed dimensions")
        return Dataset(variables, attributes)

    def _take(self, n: int) -> bytes:
        if n < 0 or self._at + n > len(self._content):
            raise InputError("file", f"ends inside its header, at byte {self._at}; {_REMEDY}")
        part = self._content[self._at : self._at + n]
        self._at += n
        return part

    def _integer(self, kind: str = ">i") -> int:
        return int(struct.unpack(kind, self._take(struct.calcsize(kind)))[0])

    def _name(self) -> str:
        length = self._integer()
        if not 0 < length <= _MAX_NAME:
            raise InputError("file", f"has a name of {length} bytes at byte {self._at}; {_REMEDY}")
        name = self._take(length).decode("utf-8", "replace")
        self._take(-length % 4)
        return name

    def _list(self, tag: int) -> int:
        found, count = self._integer(), self._integer()
        if found == 0 and count == 0:
            return 0
        if found != tag or not 0 <= count <= _MAX_ITEMS:
            raise InputError("file", f"has a damaged header at byte {self._at}; {_REMEDY}")
        return count

    def _dimensions(self) -> list[tuple[str, int]]:
        return [(self._name(), self._integer()) for _ in range(self._list(_DIMENSION))]

    def _attributes(self) -> dict[str, Attribute]:
        return dict(self._attribute() for _ in range(self._list(_ATTRIBUTE)))

    def _attribute(self) -> tuple[str, Attribute]:
        name, kind, count = self._name(), self._integer(), self._integer()
        if kind == _CHAR:
            text = self._take(count)
            self._take(-count % 4)
            return name, text.decode("utf-8", "replace").rstrip("\0")
        size = count * self._dtype(kind).itemsize
        values = np.frombuffer(self._take(size), self._dtype(kind))
        self._take(-size % 4)
        return name, tuple(float(value) for value in values)

    def _dtype(self, kind: int) -> np.dtype[Any]:
        if kind not in _TYPES:
            raise InputError("file", f"has values of unknown type {kind} at byte {self._at}; {_REMEDY}")
        return np.dtype(_TYPES[kind])

    def _variable(self, dimensions: list[tuple[str, int]]) -> tuple[str, Variable]:
        name = self._name()
        rank = self._integer()
        if not 0 <= rank <= len(dimensions):
            raise InputError("file", f"gives {name!r} {rank} dimensions; {_REMEDY}")
        ids = [self._integer() for _ in range(rank)]
        if any(not 0 <= one < len(dimensions) for one in ids):
            raise InputError("file", f"gives {name!r} a dimension that it has not; {_REMEDY}")
        attributes = self._attributes()
        kind = self._integer()
        self._integer()  # vsize: redundant, and wrong for large variables by the format's own rule
        begin = self._integer(self._offset)
        shape = tuple(dimensions[one][1] for one in ids)
        return name, Variable(
            tuple(dimensions[one][0] for one in ids), self._data(name, kind, shape, begin), attributes
        )

    def _data(self, name: str, kind: int, shape: tuple[int, ...], begin: int) -> NDArray[Any]:
        dtype = np.dtype("S1") if kind == _CHAR else self._dtype(kind)
        if any(length <= 0 for length in shape):
            raise InputError("file", f"gives {name!r} an unlimited or empty dimension; save it with fixed dimensions")
        count = math.prod(shape)
        if begin < 0 or begin + count * dtype.itemsize > len(self._content):
            raise InputError("file", f"ends before the values of {name!r}; {_REMEDY}")
        return np.frombuffer(self._content, dtype, count, begin).reshape(shape)
