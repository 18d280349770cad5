"""Tracker state as bytes with a version."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import msgpack
import numpy as np

from app.engine.calibration import SoftIron
from app.engine.errors import StateError
from app.engine.inertial import Attitude, LevelledSamples
from app.engine.inertial.carrying import Carrying
from app.engine.inertial.counter import Pedometer
from app.engine.inertial.disturbance import Calm
from app.engine.inertial.pedestrian import PedestrianState
from app.engine.inertial.pressure import Barometer
from app.engine.inertial.wheels import Odometer
from app.engine.types import DeviceCalibration, PressureReadings, Prior, SpeedReadings, StepCounts

VERSION = 6
_SOFT_IRON = ("soft_iron", "soft_iron_sd")
"""Calibrations stored before soft iron was learned are without: nothing is known of it."""


def pack(values: dict[str, Any]) -> bytes:
    """Encode a dict of plain values and numpy arrays."""
    encoded: bytes = msgpack.packb({"version": VERSION, **values}, default=_encode)
    return encoded


def unpack(payload: bytes) -> dict[str, Any]:
    """Decode what :func:`pack` made.

    Raises
    ------
    StateError
        Damaged bytes or another version.
    """
    try:
        values = msgpack.unpackb(payload, object_hook=_decode)
    except (ValueError, msgpack.UnpackException) as error:
        raise StateError(f"tracker state is damaged: {error}") from error
    if not isinstance(values, dict) or values.get("version") != VERSION:
        raise StateError(f"tracker state is not of version {VERSION}; start a new session")
    return values


def pedestrian_values(state: PedestrianState) -> dict[str, Any]:
    """A pedestrian front end's state as plain values."""
    a, tail, wheels, counter = state.attitude, state.tail, state.odometer, state.pedometer
    return {
        "attitude": [a.t, *a.q, a.heading, *a.rest],
        "last_t": [state.last_step_t, state.last_event_t],
        "t": tail.t, "mag": tail.mag, "heading": tail.heading, "vertical": tail.vertical, "up": tail.up,
        "carrying": None if state.carrying is None else asdict(state.carrying),
        "calm": None if state.calm is None else asdict(state.calm),
        "odometer": [wheels.t, wheels.piece_t, wheels.way, wheels.x, wheels.y, *wheels.piece],
        "speed": [wheels.readings.t, wheels.readings.speed],
        "pedometer": [counter.until, counter.t, counter.count, counter.told, counter.credit, counter.wary],
        "counts": [counter.readings.t, counter.readings.count],
    }  # fmt: skip


def pedestrian_state(values: dict[str, Any]) -> PedestrianState:
    """Inverse of :func:`pedestrian_values`."""
    t, w, x, y, z, heading, *rest = values["attitude"]
    last_step_t, last_event_t = values["last_t"]
    carrying, calm = values["carrying"], values["calm"]
    driven_t, piece_t, way, east, north, *piece = values["odometer"]
    until, counted_t, count, told, credit, wary = values["pedometer"]
    return PedestrianState(
        Attitude(t, (w, x, y, z), heading, tuple(rest)),
        last_step_t,
        last_event_t,
        LevelledSamples(values["t"], values["mag"], values["heading"], values["vertical"], values["up"]),
        None if carrying is None else Carrying(**{**carrying, "up": tuple(carrying["up"])}),
        None if calm is None else Calm(**calm),
        Odometer(driven_t, piece_t, way, east, north, tuple(piece), SpeedReadings(*values["speed"])),
        Pedometer(until, counted_t, count, told, credit, wary, StepCounts(*values["counts"])),
    )


def barometer_values(barometer: Barometer) -> list[Any]:
    """A barometer's state as plain values."""
    pending = barometer.pending
    return [pending.t, pending.hpa, barometer.blocks, barometer.left_m, barometer.climb_m]


def barometer_from(values: Sequence[Any]) -> Barometer:
    """Inverse of :func:`barometer_values`."""
    t, hpa, blocks, left_m, climb_m = values
    return Barometer(PressureReadings(t, hpa), tuple((at, height) for at, height in blocks), left_m, climb_m)


def prior_values(prior: Prior) -> dict[str, Any]:
    """A prior as plain values."""
    return asdict(prior)


def prior_from(values: Mapping[str, Any]) -> Prior:
    """Inverse of :func:`prior_values`; also of its JSON, where tuples come back as lists."""
    known = values.get("calibration")
    return Prior(**{**values, "calibration": None if known is None else calibration_from(known)})


def calibration_from(values: Mapping[str, Any]) -> DeviceCalibration:
    """A device's calibration from its plain values, or their JSON, where tuples come back as lists."""
    return DeviceCalibration(
        offset=tuple(values["offset"]),
        offset_sd=tuple(values["offset_sd"]),
        stride_scale=values["stride_scale"],
        stride_scale_sd=values["stride_scale_sd"],
        **{name: tuple(values[name]) for name in _SOFT_IRON if name in values},
    )


def soft_iron_values(soft_iron: SoftIron) -> list[Any]:
    """A session's estimate of soft iron as plain values."""
    return [soft_iron.mean, soft_iron.cov, soft_iron.turned, soft_iron.applied]


def soft_iron_from(values: Sequence[Any]) -> SoftIron:
    """Inverse of :func:`soft_iron_values`."""
    return SoftIron(*values)


def _encode(value: object) -> dict[str, Any]:
    if isinstance(value, np.ndarray):
        return {"__nd__": value.dtype.str, "shape": list(value.shape), "data": value.tobytes()}
    raise TypeError(f"cannot encode {type(value).__name__}")


def _decode(value: dict[str, Any]) -> Any:
    if "__nd__" in value:
        return np.frombuffer(value["data"], dtype=value["__nd__"]).reshape(value["shape"]).copy()
    return value
