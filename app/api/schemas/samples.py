"""Uploaded samples: columns, decoded straight to numpy.

In JSON a column is an array of numbers. In msgpack it is an array as well, or a binary of little-endian values:
float64 for times and plan coordinates, float32 for sensors. Pydantic checks the envelope; a column is one value to
it, so the cost does not grow with a model per sample.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from enum import StrEnum
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, ConfigDict, Field, PlainValidator, WithJsonSchema
from pydantic_core import PydanticCustomError

from app.api.schemas.base import IdRef, In, Integer, Name
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
MAX_SEQ = 2**31 - 1


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
                {"index": index, "remedy": "send BSSIDs as strings"},
            )
    return tuple(value)


AddressColumn = Annotated[
    tuple[str, ...],
    PlainValidator(_addresses),
    WithJsonSchema(
        {
            "type": "array",
            "items": {"type": "string", "minLength": 1, "maxLength": 64},
            "description": "BSSIDs.",
            "examples": [["a4:2b:8c:00:11:22", "a4:2b:8c:00:11:23"]],
        }
    ),
]


class Frame(StrEnum):
    """Body frame of an upload; see docs/api.md for the axes."""

    ANDROID = "android"
    FRD = "frd"
    FLU = "flu"
    IOS = "ios"


class ColumnsIn(In):
    """Base of requests that hold columns."""

    model_config = ConfigDict(arbitrary_types_allowed=True)


class VectorIn(ColumnsIn):
    """Three columns of one sensor."""

    x: SensorColumn
    y: SensorColumn
    z: SensorColumn


class SamplesIn(ColumnsIn):
    """Magnetometer and inertial samples on one time base."""

    t_ms: TimeColumn
    mag: Annotated[VectorIn, Field(description="Magnetic field, uT.")]
    acc: Annotated[VectorIn, Field(description="Accelerometer with gravity, m/s^2.")]
    gyro: Annotated[VectorIn, Field(description="Gyroscope, rad/s.")]


class WifiIn(ColumnsIn):
    """Wi-Fi readings: one row per access point heard."""

    t_ms: AnyTimeColumn
    bssid: AddressColumn
    rssi: Annotated[SensorColumn, Field(description="dBm (msgpack: float32).")]


class WaypointsIn(ColumnsIn):
    """Places whose position is known, at least two."""

    t_ms: TimeColumn
    x: MetreColumn
    y: MetreColumn


_VECTORS = {
    "mag": {"x": [21.5, 21.4], "y": [-4.2, -4.3], "z": [-38.0, -38.1]},
    "acc": {"x": [0.1, 0.2], "y": [0.4, 0.5], "z": [9.7, 9.9]},
    "gyro": {"x": [0.01, 0.02], "y": [0.0, 0.01], "z": [0.12, 0.11]},
}
SAMPLES_EXAMPLE: dict[str, Any] = {"t_ms": [1764000000000, 1764000000020], **_VECTORS}
SEGMENT_EXAMPLE: dict[str, Any] = {"seq": 0, "frame": "android", "samples": SAMPLES_EXAMPLE, "wifi": None}
WALK_EXAMPLE: dict[str, Any] = {
    "name": "corridor, there and back",
    "frame": "android",
    "samples": SAMPLES_EXAMPLE,
    "waypoints": {"t_ms": [1764000000000, 1764000000020], "x": [12.0, 12.02], "y": [4.0, 4.0]},
}


def _whole(value: object) -> object:
    if type(value) is not int:
        remedy = f"send an integer from 0 to {MAX_SEQ}"
        raise PydanticCustomError("seq", "is not an integer", {"remedy": remedy})
    return value


class SegmentIn(ColumnsIn):
    """One chunk of a session."""

    model_config = ConfigDict(json_schema_extra={"examples": [SEGMENT_EXAMPLE]})

    seq: Annotated[Integer, BeforeValidator(_whole), Field(ge=0, le=MAX_SEQ, description="Counts from 0 without gaps.")]
    frame: Frame = Frame.ANDROID
    samples: SamplesIn
    wifi: WifiIn | None = None


class WalkIn(ColumnsIn):
    """A survey walk."""

    model_config = ConfigDict(json_schema_extra={"examples": [WALK_EXAMPLE]})

    name: Name
    frame: Frame = Frame.ANDROID
    device_id: IdRef | None = None
    samples: SamplesIn
    waypoints: WaypointsIn
    wifi: WifiIn | None = None
