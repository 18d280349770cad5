"""What a device's sessions and survey walks taught, from the end of one to the start of the next."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import replace
from datetime import datetime

from app.engine.calibration import next_epoch, next_session, remember, remember_strides, unknown_device
from app.engine.types import DeviceCalibration, WalkReport
from app.services.errors import InvalidError
from app.services.ports import UnitOfWork
from app.services.records import DeviceMemory, SessionStatus


def starting_calibration(uow: UnitOfWork, device_id: str | None, epoch: str) -> DeviceCalibration | None:
    """What a session of the device starts with: the memory of its epoch, or of another epoch the stride only.

    None for a device never seen, and without one. NotFoundError if there is no such device.
    """
    if device_id is None:
        if epoch:
            raise InvalidError(
                "calibration_epoch", "belongs to no device", "name the device in device_id, or leave the epoch out"
            )
        return None
    return _expected(uow.devices.memories(device_id), epoch)


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


def remember_survey(uow: UnitOfWork, level_id: str, reports: Sequence[WalkReport], now: datetime) -> None:
    """Fuse the strides of survey walks into the memories of the devices they name, each walk once.

    To be called in the transaction that stores a map, before it is stored: walks of the level's earlier maps have
    taught already. The stride belongs to whoever carries the device, not to an epoch of its magnetometer: it is kept
    with the epoch used last, from where other epochs take it.
    """
    owners, known = uow.surveys.devices(level_id), uow.maps.paced_walks(level_id)
    scales: defaultdict[str, list[float]] = defaultdict(list)
    for report in reports:
        if report.stride_scale is not None and report.walk_id in owners and report.walk_id not in known:
            scales[owners[report.walk_id]].append(report.stride_scale)
    for device_id in sorted(scales):  # in one order, so that two builds never wait for each other's devices
        _remember_strides(uow, device_id, scales[device_id], now)


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
