"""From the bytes of an upload to engine types: decode, check, turn into the body frame, hash."""

from __future__ import annotations

import hashlib
from dataclasses import fields
from datetime import datetime
from typing import Any, TypeVar

import numpy as np
from pydantic import ValidationError

from app.api.aids import checked_aids, checked_ble, checked_wifi
from app.api.body import decode
from app.api.errors import RejectedError
from app.api.frames import to_android
from app.api.plausibility import SEGMENT_LIMITS, WALK_LIMITS, UploadLimits, check_samples
from app.api.schemas.base import In
from app.api.schemas.samples import Frame, SamplesIn, SegmentIn, VectorIn, WalkIn
from app.api.structure import SEGMENT_BOUNDS, Bounds
from app.api.validation import field_errors
from app.api.waypoints import Extent, check_waypoints
from app.engine.types import (
    Float64Array,
    ImuSamples,
    PressureReadings,
    RadioScans,
    SpeedReadings,
    StepCounts,
    Waypoints,
)
from app.services.aids import Aids, GnssReadings
from app.services.records import NewSegment, NewWalk

Model = TypeVar("Model", bound=In)

LARGE_BYTES = 512 * 1024
"""Uploads above this are decoded a few at a time; a 5-s segment is 11 kB (msgpack) to 24 kB (JSON)."""


def parse(body: bytes, kind: str, model: type[Model], bounds: Bounds = SEGMENT_BOUNDS) -> Model:
    """Decode a body within bounds and check its envelope; RejectedError names every field that does not fit."""
    value: Any = decode(body, kind, bounds)
    try:
        return model.model_validate(value)
    except ValidationError as error:
        raise RejectedError(field_errors(error.errors(include_url=False, include_input=False))) from error


def new_segment(upload: SegmentIn, now: datetime) -> NewSegment:
    """Check a segment and turn it into what the services take."""
    samples = checked_samples(upload.samples, upload.frame, SEGMENT_LIMITS, now)
    aids = checked_aids(upload, upload.samples.t_ms)
    return NewSegment(seq=upload.seq, samples=samples, content_hash=content_hash(samples, aids), aids=aids)


def new_walk(upload: WalkIn, extent: Extent, now: datetime) -> NewWalk:
    """Check a survey walk on a level of this extent and turn it into what the services take.

    The hash covers what was measured, not how the walk is called: a repeated upload under another name is the
    same walk.
    """
    samples = checked_samples(upload.samples, upload.frame, WALK_LIMITS, now)
    wifi = checked_wifi(upload.wifi, upload.samples.t_ms)
    ble = checked_ble(upload.ble, upload.samples.t_ms)
    check_waypoints(upload.waypoints, upload.samples.t_ms, extent)
    waypoints = Waypoints(upload.waypoints.t_ms / 1000.0, upload.waypoints.x, upload.waypoints.y)
    return NewWalk(
        name=upload.name,
        samples=samples,
        waypoints=waypoints,
        content_hash=content_hash(samples, Aids(wifi, ble), waypoints),
        wifi=wifi,
        device_id=upload.device_id,
        ble=ble,
        calibration_epoch=upload.calibration_epoch,
    )


def checked_samples(upload: SamplesIn, frame: Frame, limits: UploadLimits, now: datetime) -> ImuSamples:
    """Check and convert the samples of any upload."""
    check_samples(upload, limits, now)
    return ImuSamples(
        t=upload.t_ms / 1000.0,
        mag=_rows(upload.mag, frame),
        acc=_rows(upload.acc, frame, specific_force=True),
        gyro=_rows(upload.gyro, frame),
    )


def content_hash(samples: ImuSamples, aids: Aids, waypoints: Waypoints | None = None) -> str:
    """SHA-256 of the columns as stored, so that JSON, msgpack and every frame of the same readings agree."""
    digest = hashlib.sha256(b"isodyn-upload-1")
    _update(digest, samples.t)
    for rows in (samples.mag, samples.acc, samples.gyro):
        _update(digest, rows.astype("<f4"))
    if aids.wifi is not None:
        _update_scans(digest, aids.wifi)
    if waypoints is not None:
        for column in (waypoints.t, waypoints.x, waypoints.y):
            _update(digest, column)
    for name in ("ble", "gnss", "pressure", "speed", "steps"):
        aid = getattr(aids, name)
        if aid is not None:
            # two zero bytes are in no address: what follows cannot be taken for one
            digest.update(b"\x00\x00" + name.encode())
            _update_aid(digest, aid)
    return digest.hexdigest()


def _update_aid(digest: Any, aid: RadioScans | GnssReadings | PressureReadings | SpeedReadings | StepCounts) -> None:
    if isinstance(aid, RadioScans):
        _update_scans(digest, aid)
        return
    for field in fields(aid):
        _update(digest, getattr(aid, field.name))


def _update_scans(digest: Any, scans: RadioScans) -> None:
    _update(digest, scans.t)
    _update(digest, scans.rssi.astype("<f4"))
    digest.update("\x00".join(scans.address).encode())


def _update(digest: Any, column: np.ndarray[Any, Any]) -> None:
    # The length keeps columns of different splits apart.
    digest.update(column.size.to_bytes(8, "little"))
    digest.update(np.ascontiguousarray(column).tobytes())


def _rows(vector: VectorIn, frame: Frame, *, specific_force: bool = False) -> Float64Array:
    return to_android(np.stack((vector.x, vector.y, vector.z)), frame, specific_force=specific_force)
