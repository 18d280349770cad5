"""Models of devices: what the devices of one have in common, published and as the start of a new one."""

from __future__ import annotations

from dataclasses import replace

from app.engine.calibration import estimate_model
from app.engine.types import DeviceCalibration
from app.services.base import DEFAULT_LIMIT, Service, check_limit
from app.services.ports import UnitOfWork
from app.services.records import DeviceModel, Page

MIN_DEVICES = 3
"""Fewer devices that taught something would be recognized in what they have in common; nor would it be worth much."""
MAX_DEVICES = 32
"""Devices that an estimate rests on, those used last: with so many the mean is known to a sixth of the spread, and
more would cost every start of a session for nothing."""


class DeviceModelService(Service):
    """Read models."""

    def list(self, cursor: str | None = None, limit: int = DEFAULT_LIMIT) -> Page[DeviceModel]:
        """Models by name, with the number of their devices; without estimates."""
        with self._uow() as uow:
            return uow.device_models.list(cursor=cursor, limit=check_limit(limit))

    def get(self, name: str) -> DeviceModel:
        """One model with what its devices have in common, if enough of them taught something."""
        with self._uow() as uow:
            model = uow.device_models.get(name)
            memories = uow.device_models.memories(name, limit=MAX_DEVICES)
        estimate = estimate_model(memories)
        return replace(model, estimate=estimate) if estimate.n_devices >= MIN_DEVICES else model


def model_start(uow: UnitOfWork, name: str | None, device_id: str) -> DeviceCalibration | None:
    """What its model tells of a device before anything is known of itself; None where too few others taught."""
    if name is None:
        return None
    memories = uow.device_models.memories(name, limit=MAX_DEVICES, without=device_id)
    if len(memories) < MIN_DEVICES:
        return None
    estimate = estimate_model(memories)
    return estimate.start if estimate.n_devices >= MIN_DEVICES else None
