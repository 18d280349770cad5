"""Uploaded samples: segments and survey walks.

Pydantic checks the envelope; a column is one value to it (:mod:`app.api.schemas.columns`), so the cost does not grow
with a model per sample.
"""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated, Any

from pydantic import BeforeValidator, ConfigDict, Field
from pydantic_core import PydanticCustomError

from app.api.schemas.aids import AIDS_EXAMPLE, AidsIn, BleIn, WifiIn
from app.api.schemas.base import Epoch, IdRef, Integer, Name
from app.api.schemas.columns import ColumnsIn, MetreColumn, SensorColumn, TimeColumn

MAX_SEQ = 2**31 - 1


class Frame(StrEnum):
    """Body frame of an upload; see docs/api.md for the axes."""

    ANDROID = "android"
    FRD = "frd"
    FLU = "flu"
    IOS = "ios"


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
SEGMENT_EXAMPLE: dict[str, Any] = {"seq": 0, "frame": "android", "samples": SAMPLES_EXAMPLE, **AIDS_EXAMPLE}
WALK_EXAMPLE: dict[str, Any] = {
    "name": "corridor, there and back",
    "frame": "android",
    "samples": SAMPLES_EXAMPLE,
    "waypoints": {"t_ms": [1764000000000, 1764000000020], "x": [12.0, 12.02], "y": [4.0, 4.0]},
    **{name: AIDS_EXAMPLE[name] for name in ("wifi", "ble")},
}


def _whole(value: object) -> object:
    if type(value) is not int:
        remedy = f"send an integer from 0 to {MAX_SEQ}"
        raise PydanticCustomError("seq", "is not an integer", {"remedy": remedy})
    return value


class SegmentIn(AidsIn):
    """One chunk of a session."""

    model_config = ConfigDict(json_schema_extra={"examples": [SEGMENT_EXAMPLE]})

    seq: Annotated[Integer, BeforeValidator(_whole), Field(ge=0, le=MAX_SEQ, description="Counts from 0 without gaps.")]
    frame: Frame = Frame.ANDROID
    samples: SamplesIn


class WalkIn(ColumnsIn):
    """A survey walk."""

    model_config = ConfigDict(json_schema_extra={"examples": [WALK_EXAMPLE]})

    name: Name
    frame: Frame = Frame.ANDROID
    device_id: IdRef | None = None
    calibration_epoch: Annotated[
        Epoch,
        Field(description="Changes when the platform recalibrates the device's magnetometer: as sessions name it."),
    ] = ""
    samples: SamplesIn
    waypoints: WaypointsIn
    wifi: WifiIn | None = None
    ble: BleIn | None = None
