"""Devices."""

from __future__ import annotations

from typing import Any

from sqlalchemy import Row, insert, select

from app.services.records import Device, Page
from app.storage.models import devices
from app.storage.repositories.base import Repository


class SqlDeviceRepository(Repository):
    """Port ``DeviceRepository``."""

    def add(self, device: Device) -> None:
        """Store a device."""
        self._write(
            insert(devices).values(id=device.id, name=device.name, model=device.model, created_at=device.created_at)
        )

    def get(self, device_id: str) -> Device:
        """One device."""
        return _device(self._one("device", device_id, select(devices).where(devices.c.id == device_id)))

    def list(self, *, cursor: str | None, limit: int) -> Page[Device]:
        """Devices, newest first."""
        return self._newest_first(select(devices), devices.c.id, _device, cursor=cursor, limit=limit)


def _device(row: Row[Any]) -> Device:
    return Device(row.id, row.name, row.model, created_at=row.created_at)
