"""Devices: physical sensor carriers."""

from __future__ import annotations

from collections.abc import Sequence

from app.services.base import DEFAULT_LIMIT, Service, check_limit
from app.services.device_memory import starting_calibration
from app.services.ids import new_id
from app.services.records import Device, DeviceMemory, Page, StartingCalibration


class DeviceService(Service):
    """Create and read devices."""

    def create(self, name: str, model: str | None = None) -> Device:
        """Create a device."""
        now = self._clock()
        device = Device(new_id("dev", now), name, model, created_at=now)
        with self._uow(write=True) as uow:
            uow.devices.add(device)
        return device

    def get(self, device_id: str) -> Device:
        """One device."""
        with self._uow() as uow:
            return uow.devices.get(device_id)

    def memories(self, device_id: str) -> Sequence[DeviceMemory]:
        """What sessions taught about a device, per epoch of its magnetometer; the epoch used last first."""
        with self._uow() as uow:
            return uow.devices.memories(device_id)

    def next_start(self, device_id: str) -> StartingCalibration:
        """What a session of the device would start with now, in the epoch used last."""
        with self._uow() as uow:
            memories = uow.devices.memories(device_id)
            return starting_calibration(uow, device_id, memories[0].epoch if memories else "")

    def forget(self, device_id: str) -> None:
        """Forget what sessions taught about a device: the next one starts as with a new device."""
        with self._uow(write=True) as uow:
            uow.devices.get(device_id)
            uow.devices.forget(device_id)

    def list(self, cursor: str | None = None, limit: int = DEFAULT_LIMIT) -> Page[Device]:
        """Devices, newest first."""
        with self._uow() as uow:
            return uow.devices.list(cursor=cursor, limit=check_limit(limit))
