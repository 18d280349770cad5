"""A new device of a known model starts with what the model's other devices have in common; single ones are not told."""

from __future__ import annotations

from dataclasses import astuple

import numpy as np
import pytest

from app.engine.calibration import estimate_model, next_epoch, next_session, unknown_device, with_model
from app.engine.types import DeviceCalibration
from app.services.device_models import MAX_DEVICES, MIN_DEVICES
from app.services.errors import NotFoundError
from app.services.records import CalibrationSource, Device, DeviceMemory, Page
from tests.support.builders import START, World, calibration, locate_result, new_segment


class Shop:
    """Devices of one model, some of which taught something."""

    def __init__(self, world: World) -> None:
        self.world = world
        self.level_id = world.mapped_level().id

    def device(self, model: str | None = "M1") -> Device:
        return self.world.services.devices.create("phone", model)

    def taught(self, offset: float, model: str = "M1", epoch: str = "") -> DeviceCalibration:
        """A new device with a memory."""
        device = self.device(model)
        return self.teach(device, offset, epoch)

    def teach(self, device: Device, offset: float, epoch: str = "") -> DeviceCalibration:
        known = calibration(offset)
        with self.world.database(write=True) as uow:
            uow.devices.set_memory(DeviceMemory(device.id, epoch, known, 1, self.world.clock()))
        return known

    def start_of(self, device: Device, epoch: str = "") -> DeviceCalibration | None:
        session = self.world.services.sessions.create(
            self.level_id, "particle", {}, device_id=device.id, calibration_epoch=epoch
        )
        return session.prior.calibration


def close(one: DeviceCalibration | None, other: DeviceCalibration | None) -> bool:
    """Whether two are the same but for the order in which devices were summed up."""
    if one is None or other is None:
        return one is other
    flat = [np.hstack([np.ravel(value) for value in astuple(known)]) for known in (one, other)]
    return bool(np.allclose(*flat, rtol=1e-9, atol=1e-12))


@pytest.fixture
def shop(world: World) -> Shop:
    return Shop(world)


def test_a_new_device_starts_with_its_model(shop: Shop) -> None:
    memories = [shop.taught(offset) for offset in (4.0, 5.0, 6.0)]
    shop.taught(-9.0, model="M2")
    device = shop.device()
    start = shop.start_of(device)
    assert close(start, estimate_model(memories).start)
    told = shop.world.services.devices.next_start(device.id)
    assert (told.source, told.calibration) == (CalibrationSource.MODEL, start)
    assert shop.start_of(shop.device("M3")) is None
    assert shop.start_of(shop.device(None)) is None
    assert shop.world.services.devices.next_start(shop.device(None).id).source is CalibrationSource.NONE


def test_a_known_device_takes_from_others_what_it_does_not_know(shop: Shop) -> None:
    memories = [shop.taught(offset) for offset in (4.0, 5.0, 6.0)]
    device = shop.device()
    own = shop.teach(device, -2.0, "bias-1")
    model = estimate_model(memories).start  # without the device itself: it counts once
    assert close(shop.start_of(device, "bias-1"), with_model(next_session(own), model))
    assert close(shop.start_of(device, "bias-2"), with_model(next_epoch(own), model))
    told = shop.world.services.devices.next_start(device.id)
    assert (told.epoch, told.source) == ("bias-1", CalibrationSource.DEVICE)
    assert close(told.calibration, with_model(next_session(own), model))


def test_few_devices_tell_nothing(shop: Shop) -> None:
    for offset in range(MIN_DEVICES - 1):
        shop.taught(float(offset))
    assert shop.start_of(shop.device()) is None
    assert shop.world.services.device_models.get("M1").estimate is None
    device = shop.device()
    own = shop.teach(device, 7.0)
    assert shop.world.services.device_models.get("M1").estimate is not None
    assert shop.start_of(device) == next_session(own)
    assert shop.start_of(shop.device()) is not None


def test_devices_that_taught_nothing_do_not_count(shop: Shop) -> None:
    shop.taught(3.0)
    with shop.world.database(write=True) as uow:
        for k in range(4):
            device = Device(f"dev_{k}", "phone", "M1", START)
            uow.devices.add(device)
            uow.devices.set_memory(DeviceMemory(device.id, "", unknown_device(), 1, START))
    assert shop.world.services.device_models.get("M1").estimate is None
    assert shop.start_of(shop.device()) is None


def test_what_came_from_the_model_is_not_taught_back(shop: Shop) -> None:
    """A session that learned nothing beyond its start leaves its device without evidence of its own."""
    for offset in (4.0, 5.0, 6.0):
        shop.taught(offset)
    before = shop.world.services.device_models.get("M1").estimate
    device = shop.device()
    session = shop.world.services.sessions.create(shop.level_id, "particle", {}, device_id=device.id)
    shop.world.services.sessions.accept(session.id, new_segment(0, n=20))
    (job,) = shop.world.services.processing.claim(9)
    result = locate_result(0, level_id=shop.level_id, learned=session.prior.calibration)
    shop.world.services.processing.complete_locate(job, result)
    shop.world.services.sessions.close(session.id)
    (memory,) = shop.world.services.devices.memories(device.id)
    assert memory.calibration == unknown_device()
    assert shop.world.services.device_models.get("M1").estimate == before
    assert shop.start_of(device) == (before and before.start)


def test_models_are_listed_by_name_in_pages(shop: Shop) -> None:
    for name in ("b", "a/c d", "b", "c", "b"):
        shop.device(name)
    shop.device(None)
    models = shop.world.services.device_models
    first = models.list(limit=2)
    assert [(model.name, model.n_devices) for model in first.items] == [("a/c d", 1), ("b", 3)]
    second = models.list(first.next_cursor, limit=2)
    assert [(model.name, model.n_devices) for model in second.items] == [("c", 1)]
    assert second.next_cursor is None
    with pytest.raises(NotFoundError):
        models.get("d")


def test_without_devices_there_are_no_models(world: World) -> None:
    assert world.services.device_models.list() == Page((), None)


def test_the_devices_used_last_count(shop: Shop) -> None:
    shop.taught(50.0)
    for _ in range(MAX_DEVICES):
        shop.taught(4.0)
    many = shop.world.services.device_models.get("M1").estimate
    assert many is not None
    assert many.n_devices == MAX_DEVICES
    assert many == estimate_model([calibration(4.0)] * MAX_DEVICES)
