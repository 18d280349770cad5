"""What a device's sessions and survey walks taught, from the end of one to the start of the next."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import replace
from datetime import datetime

from app.engine.calibration import (
    next_epoch,
    next_session,
    remember,
    remember_offsets,
    remember_strides,
    unknown_device,
    with_model,
)
from app.engine.types import DeviceCalibration, WalkReport
from app.services.device_models import model_start
from app.services.errors import InvalidError
from app.services.ports import UnitOfWork
from app.services.records import CalibrationSource, DeviceMemory, SessionStatus, StartingCalibration

MIN_COMPARED = 4
"""Walks of a map from which on their offsets are compared with one another's; of fewer each is only its own."""


def starting_calibration(uow: UnitOfWork, device_id: str | None, epoch: str) -> StartingCalibration:
    """What a session of the device starts with: the memory of its epoch, or of another epoch the stride only.

    For what the device itself did not teach, its model stands, if enough other devices of it did. Nothing for a device
    never seen of a model never seen, and without a device. NotFoundError if there is no such device.

    Reads much and computes for some milliseconds: not to be called in a transaction that writes.
    """
    if device_id is None:
        if epoch:
            raise InvalidError(
                "calibration_epoch", "belongs to no device", "name the device in device_id, or leave the epoch out"
            )
        return StartingCalibration(epoch, CalibrationSource.NONE, None)
    known = _expected(uow.devices.memories(device_id), epoch)
    model = model_start(uow, uow.devices.get(device_id).model, device_id)
    if known is None:
        source = CalibrationSource.NONE if model is None else CalibrationSource.MODEL
        return StartingCalibration(epoch, source, model)
    start = known if model is None else with_model(known, model)
    return StartingCalibration(epoch, CalibrationSource.DEVICE, start)


def remember_if_over(uow: UnitOfWork, session_id: str, now: datetime) -> None:
    """Fuse what a session learned into its device's memory, once: when it is closed and its last segment is done.

    To be called in the transaction that closes the session or ends one of its jobs. Both hold the session's row until
    they commit, so whichever comes second finds the session over.
    """
    session = uow.sessions.get(session_id)
    if session.device_id is None or session.status is SessionStatus.OPEN or uow.jobs.is_pending(session_id):
        return
    memories = uow.devices.memories(session.device_id)
    learned = uow.sessions.learned(session_id)
    if not uow.sessions.mark_remembered(session_id, now) or learned is None:
        return
    epoch = session.calibration_epoch
    expected = _expected(memories, epoch) or unknown_device()
    uow.devices.set_memory(
        DeviceMemory(
            device_id=session.device_id,
            epoch=epoch,
            calibration=remember(expected, session.prior.calibration, learned),
            n_sessions=1 + sum(memory.n_sessions for memory in memories if memory.epoch == epoch),
            updated_at=now,
        )
    )


def remember_survey(
    uow: UnitOfWork, level_id: str, reports: Sequence[WalkReport], now: datetime, *, aligned: bool = True
) -> None:
    """Fuse what survey walks told into the memories of the devices they name, each walk once.

    To be called in the transaction that stores a map, before it is stored: walks of the level's earlier maps have
    taught their stride already. The stride belongs to whoever carries the device, not to an epoch of its magnetometer:
    it is kept with the epoch used last, from where other epochs take it. The offset is of the walk's own epoch.

    Offsets are told only where walks were ``aligned``, and enough of them to compare one with the others.
    """
    carriers, known = uow.surveys.carriers(level_id), uow.maps.paced_walks(level_id)
    of_devices = [(report, carriers[report.walk_id]) for report in reports if report.walk_id in carriers]
    scales: defaultdict[str, list[float]] = defaultdict(list)
    offsets: defaultdict[tuple[str, str], list[WalkReport]] = defaultdict(list)
    compared = aligned and sum(report.rejected is None for report in reports) >= MIN_COMPARED
    for report, carrier in of_devices:
        if report.stride_scale is not None and report.walk_id not in known:
            scales[carrier.device_id].append(report.stride_scale)
        if compared and report.rejected is None and not carrier.offset_remembered:
            offsets[carrier.device_id, carrier.epoch].append(report)
    # in one order, so that two builds never wait for each other's devices
    for device_id in sorted({*scales, *(device_id for device_id, _ in offsets)}):
        if device_id in scales:
            _remember_strides(uow, device_id, scales[device_id], now)
        for epoch in sorted(epoch for owner, epoch in offsets if owner == device_id):
            _remember_offsets(uow, device_id, epoch, offsets[device_id, epoch], now)


def _remember_offsets(
    uow: UnitOfWork, device_id: str, epoch: str, reports: Sequence[WalkReport], now: datetime
) -> None:
    memories = uow.devices.memories(device_id)
    same = next((memory for memory in memories if memory.epoch == epoch), None)
    before = unknown_device() if not memories else next_epoch(memories[0].calibration)
    expected = before if same is None else next_session(same.calibration)
    iron = remember_offsets(expected, [report.offset for report in reports])
    # stride and soft iron are as old as they were: these walks told nothing of them here
    taught = replace(before if same is None else same.calibration, offset=iron.offset, offset_sd=iron.offset_sd)
    uow.devices.set_memory(DeviceMemory(device_id, epoch, taught, 0 if same is None else same.n_sessions, now))
    uow.surveys.mark_offsets_remembered([report.walk_id for report in reports], now)


def _remember_strides(uow: UnitOfWork, device_id: str, scales: Sequence[float], now: datetime) -> None:
    memories = uow.devices.memories(device_id)
    latest = memories[0] if memories else DeviceMemory(device_id, "", unknown_device(), n_sessions=0, updated_at=now)
    before = latest.calibration
    # the iron is as old as it was: a survey tells nothing of it, so it does not fade either
    stride = remember_strides(next_session(before) if memories else before, scales)
    taught = replace(before, stride_scale=stride.stride_scale, stride_scale_sd=stride.stride_scale_sd)
    uow.devices.set_memory(replace(latest, calibration=taught, updated_at=now))


def _expected(memories: Sequence[DeviceMemory], epoch: str) -> DeviceCalibration | None:
    for memory in memories:
        if memory.epoch == epoch:
            return next_session(memory.calibration)
    return next_epoch(memories[0].calibration) if memories else None
