"""Devices, and what their sessions taught about them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from sqlalchemy import Row, delete, insert, select

from app.engine.types import DeviceCalibration
from app.services.records import Device, DeviceMemory, Page
from app.storage.models import device_calibrations, devices
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

    def memories(self, device_id: str) -> Sequence[DeviceMemory]:
        """What is remembered of the device, the epoch used last first; in a writing transaction nobody else changes it.

        NotFoundError if there is no such device.
        """
        device = select(devices).where(devices.c.id == device_id)
        # Rows that are not there yet cannot be locked: the device stands for them. Not its key: whoever inserts a row
        # that refers to the device holds that in common with others, and two of them would wait for each other.
        self._one("device", device_id, device.with_for_update(key_share=True) if self._writable else device)
        table = device_calibrations
        statement = select(table).where(table.c.device_id == device_id)
        return tuple(map(_memory, self._read(statement.order_by(table.c.updated_at.desc(), table.c.epoch))))

    def set_memory(self, memory: DeviceMemory) -> None:
        """Remember this of the device's epoch, in place of what was."""
        table = device_calibrations
        self._write(delete(table).where(table.c.device_id == memory.device_id, table.c.epoch == memory.epoch))
        model = select(devices.c.model).where(devices.c.id == memory.device_id).scalar_subquery()
        self._write(insert(table).values({**_columns(memory), "model": model}))

    def forget(self, device_id: str) -> None:
        """Delete all that is remembered of the device."""
        self._write(delete(device_calibrations).where(device_calibrations.c.device_id == device_id))


def _columns(memory: DeviceMemory) -> dict[str, Any]:
    known = memory.calibration
    return {
        "device_id": memory.device_id,
        "epoch": memory.epoch,
        **{f"offset_{axis}": known.offset[i] for i, axis in enumerate("xyz")},
        **{f"offset_sd_{axis}": known.offset_sd[i] for i, axis in enumerate("xyz")},
        "stride_scale": known.stride_scale,
        "stride_scale_sd": known.stride_scale_sd,
        "soft_iron": [list(known.soft_iron), list(known.soft_iron_sd)],
        "n_sessions": memory.n_sessions,
        "updated_at": memory.updated_at,
    }


def _memory(row: Row[Any]) -> DeviceMemory:
    return DeviceMemory(row.device_id, row.epoch, calibration_of(row), row.n_sessions, row.updated_at)


def calibration_of(row: Row[Any]) -> DeviceCalibration:
    """The calibration of a stored memory."""
    calibration = DeviceCalibration(
        offset=(row.offset_x, row.offset_y, row.offset_z),
        offset_sd=(row.offset_sd_x, row.offset_sd_y, row.offset_sd_z),
        stride_scale=row.stride_scale,
        stride_scale_sd=row.stride_scale_sd,
    )
    if row.soft_iron is not None:  # remembered before soft iron was: nothing is known of it
        elements, sd = map(tuple, row.soft_iron)
        calibration = replace(calibration, soft_iron=elements, soft_iron_sd=sd)
    return calibration


def _device(row: Row[Any]) -> Device:
    return Device(row.id, row.name, row.model, created_at=row.created_at)
