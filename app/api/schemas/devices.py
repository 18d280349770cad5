"""Devices."""

from __future__ import annotations

from typing import Self

from app.api.schemas.base import In, Name, Out, PageOut, Time, example
from app.services import records

DEVICE_ID = "dev_019ab2c4d1e07f3a9b2c4d5e6f"
_DEVICE = {"id": DEVICE_ID, "name": "Ada's phone", "model": "OPPO PBCM10", "created_at": "2026-11-22T09:30:00.000Z"}


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


class DevicePage(PageOut):
    """Devices, newest first."""

    model_config = example({"items": [_DEVICE], "next_cursor": None})

    items: list[DeviceOut]
