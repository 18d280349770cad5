"""Devices."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any, Self

from pydantic import Field

from app.api.schemas.base import In, Name, Out, PageOut, Time, example
from app.engine.types import DeviceCalibration
from app.services import records

DEVICE_ID = "dev_019ab2c4d1e07f3a9b2c4d5e6f"
_DEVICE = {"id": DEVICE_ID, "name": "Ada's phone", "model": "OPPO PBCM10", "created_at": "2026-11-22T09:30:00.000Z"}
CALIBRATION_EXAMPLE: dict[str, Any] = {
    "offset": [4.1, -7.6, 2.2],
    "offset_sd": [2.83, 2.83, 2.83],
    "stride_scale": 1.04,
    "stride_scale_sd": 0.045,
    "soft_iron": [0.021, -0.034, 0.006, 0.012, -0.008, 0.015],
    "soft_iron_sd": [0.014, 0.013, 0.035, 0.012, 0.013, 0.013],
}
_MEMORY = {
    "epoch": "bias-5f2c",
    **CALIBRATION_EXAMPLE,
    "offset_sd": [2.0, 2.0, 2.0],
    "stride_scale_sd": 0.04,
    "n_sessions": 3,
    "updated_at": "2026-11-22T09:42:10.000Z",
}
_AXES = Field(min_length=3, max_length=3, description="Forward, left, up of the levelled device, uT.")
_ELEMENTS = Field(
    min_length=6,
    max_length=6,
    description="Forward-forward, left-left, up-up, forward-left, forward-up, left-up of the symmetric matrix S, "
    "levelled device: a true field m reads (I + S) m + offset.",
)


class CalibrationOut(Out):
    """What is known about a device and its carrier, with standard deviations."""

    model_config = example(CALIBRATION_EXAMPLE)

    offset: Annotated[list[float], _AXES]
    offset_sd: Annotated[list[float], _AXES]
    stride_scale: Annotated[float, Field(description="Stride of the carrier over that of the stride model.")]
    stride_scale_sd: float
    soft_iron: Annotated[list[float], _ELEMENTS]
    soft_iron_sd: Annotated[list[float], _ELEMENTS]

    @classmethod
    def of(cls, known: DeviceCalibration) -> Self:
        """Show a calibration."""
        return cls(**_calibration(known))


class DeviceCalibrationOut(CalibrationOut):
    """What sessions taught about a device, in one epoch of its magnetometer."""

    model_config = example(_MEMORY)

    epoch: Annotated[str, Field(description="The sessions' `calibration_epoch`.")]
    n_sessions: Annotated[
        int, Field(description="Closed sessions that taught something; 0 where only survey walks did.")
    ]
    updated_at: Time

    @classmethod
    def of_memory(cls, memory: records.DeviceMemory) -> Self:
        """Show what is remembered."""
        return cls(
            **_calibration(memory.calibration),
            epoch=memory.epoch,
            n_sessions=memory.n_sessions,
            updated_at=memory.updated_at,
        )


def _calibration(known: DeviceCalibration) -> dict[str, Any]:
    return {
        "offset": list(known.offset),
        "offset_sd": list(known.offset_sd),
        "stride_scale": known.stride_scale,
        "stride_scale_sd": known.stride_scale_sd,
        "soft_iron": list(known.soft_iron),
        "soft_iron_sd": list(known.soft_iron_sd),
    }


class DeviceIn(In):
    """A device to register."""

    model_config = example({"name": "Ada's phone", "model": "OPPO PBCM10"})

    name: Name
    model: Name | None = None


class DeviceOut(Out):
    """One physical sensor carrier."""

    model_config = example(_DEVICE)

    id: str
    name: str
    model: str | None
    created_at: Time

    @classmethod
    def of(cls, device: records.Device) -> Self:
        """Show a device."""
        return cls(id=device.id, name=device.name, model=device.model, created_at=device.created_at)


_START = {"epoch": "bias-5f2c", "source": "device", "calibration": CALIBRATION_EXAMPLE}


class StartOut(Out):
    """What the next session starts with."""

    model_config = example(_START)

    epoch: Annotated[str, Field(description="If it is of this `calibration_epoch`: the one used last.")]
    source: Annotated[
        records.CalibrationSource,
        Field(description="`device`: its own memory, and for what that does not hold its model; `model`; or `none`."),
    ]
    calibration: Annotated[CalibrationOut | None, Field(description="Null: nothing is known.")]

    @classmethod
    def of(cls, start: records.StartingCalibration) -> Self:
        """Show a start."""
        known = start.calibration and CalibrationOut.of(start.calibration)
        return cls(epoch=start.epoch, source=start.source, calibration=known)


class DeviceDetailOut(DeviceOut):
    """A device with what its sessions taught about it."""

    model_config = example({**_DEVICE, "calibrations": [_MEMORY], "next_session": _START})

    next_session: StartOut
    calibrations: Annotated[list[DeviceCalibrationOut], Field(description="Per epoch, the one used last first.")]

    @classmethod
    def with_memories(
        cls,
        device: records.Device,
        memories: Sequence[records.DeviceMemory],
        start: records.StartingCalibration,
    ) -> Self:
        """Show a device, what is remembered of it, and what that makes of its next session."""
        calibrations = [DeviceCalibrationOut.of_memory(memory) for memory in memories]
        next_session = StartOut.of(start)
        return cls(**DeviceOut.of(device).model_dump(), calibrations=calibrations, next_session=next_session)


class DevicePage(PageOut):
    """Devices, newest first."""

    model_config = example({"items": [_DEVICE], "next_cursor": None})

    items: list[DeviceOut]
