"""Columns of uploads, decoded straight to numpy.

In JSON a column is an array of numbers. In msgpack it is an array as well, or a binary of little-endian values:
float64 for times, coordinates and counts, float32 for sensors. Pydantic checks the envelope; a column is one value to
it, so the cost does not grow with a model per sample.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict, PlainValidator, WithJsonSchema
from pydantic_core import PydanticCustomError

from app.api.schemas.base import In
from app.engine.types import Float64Array

_NUMBERS = frozenset({int, float})
_WORDS: Mapping[type, str] = {
    type(None): "null",
    str: "a string",
    bool: "a boolean",
    list: "an array",
    dict: "an object",
    bytes: "a binary",
}


def _column(dtype: str) -> Callable[[object], Float64Array]:
    kind = np.dtype(dtype)

    def validate(value: object) -> Float64Array:
        if isinstance(value, list):
            # set(map(type, ..)) finds strings, nulls and booleans at C speed; numpy would convert them silently.
            if not set(map(type, value)) <= _NUMBERS:
                raise _not_a_number(value)
            with np.errstate(over="ignore"):
                return np.array(value, dtype=np.float64).astype(kind).astype(np.float64)
        if isinstance(value, bytes):
            if len(value) % kind.itemsize:
                raise PydanticCustomError(
                    "column_bytes",
                    "has {size} bytes, not a multiple of {item}",
                    {"size": len(value), "item": kind.itemsize, "remedy": f"send little-endian {kind.name} values"},
                )
            return np.frombuffer(value, dtype=kind).astype(np.float64)
        raise PydanticCustomError(
            "column_type",
            "is not a column",
            {"remedy": f"send an array of numbers (msgpack also: a binary of little-endian {kind.name})"},
        )

    return validate


def _not_a_number(values: list[Any]) -> PydanticCustomError:
    index, value = next((i, v) for i, v in enumerate(values) if type(v) not in _NUMBERS)
    what = _WORDS.get(type(value), "something else")
    return PydanticCustomError(
        "column_value",
        "value {index} is {what}, not a number",
        {"index": index, "what": what, "remedy": "send numbers only; leave a sample out if a reading is missing"},
    )


def _schema(description: str, example: list[float]) -> WithJsonSchema:
    return WithJsonSchema(
        {"type": "array", "items": {"type": "number"}, "description": description, "examples": [example]}
    )


TimeColumn = Annotated[
    NDArray[np.float64],
    PlainValidator(_column("<f8")),
    _schema("Unix milliseconds, strictly increasing (msgpack: float64).", [1764000000000, 1764000000020]),
]
SensorColumn = Annotated[
    NDArray[np.float64],
    PlainValidator(_column("<f4")),
    _schema("One value a sample, kept as float32 (msgpack: float32).", [21.5, 21.4]),
]
MetreColumn = Annotated[
    NDArray[np.float64],
    PlainValidator(_column("<f8")),
    _schema("Metres in the level frame (msgpack: float64).", [12.0, 18.5]),
]
DegreeColumn = Annotated[
    NDArray[np.float64],
    PlainValidator(_column("<f8")),
    _schema("WGS 84, degrees (msgpack: float64).", [48.15071, 48.15072]),
]
CountColumn = Annotated[
    NDArray[np.float64],
    PlainValidator(_column("<f8")),
    _schema("Whole numbers that never fall (msgpack: float64).", [5120, 5122]),
]
AnyTimeColumn = Annotated[
    NDArray[np.float64],
    PlainValidator(_column("<f8")),
    _schema("Unix milliseconds, in any order (msgpack: float64).", [1764000000000, 1764000000000]),
]


def _addresses(value: object) -> tuple[str, ...]:
    if not isinstance(value, list):
        raise PydanticCustomError("column_type", "is not a column", {"remedy": "send an array of strings"})
    for index, item in enumerate(value):
        if not isinstance(item, str) or not 0 < len(item) <= 64 or not item.isprintable():
            raise PydanticCustomError(
                "column_value",
                "value {index} is not an address of 1 to 64 characters",
                {"index": index, "remedy": "send BSSIDs (Wi-Fi) or addresses (BLE) as strings"},
            )
    return tuple(value)


def _address_schema(description: str, example: list[str]) -> WithJsonSchema:
    item = {"type": "string", "minLength": 1, "maxLength": 64}
    return WithJsonSchema({"type": "array", "items": item, "description": description, "examples": [example]})


BssidColumn = Annotated[
    tuple[str, ...],
    PlainValidator(_addresses),
    _address_schema("BSSIDs.", ["a4:2b:8c:00:11:22", "a4:2b:8c:00:11:23"]),
]
BeaconColumn = Annotated[
    tuple[str, ...],
    PlainValidator(_addresses),
    _address_schema(
        "What names the transmitter for good: a MAC address that does not change, or a beacon's UUID with its numbers.",
        ["c0:ff:ee:00:00:01", "fda50693-a4e2-4fb1-afcf-c6eb07647825-10-7"],
    ),
]


class ColumnsIn(In):
    """Base of requests that hold columns."""

    model_config = ConfigDict(arbitrary_types_allowed=True)
