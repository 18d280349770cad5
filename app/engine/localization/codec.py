"""Tracker state as bytes with a version."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import msgpack
import numpy as np

from app.engine.errors import StateError
from app.engine.inertial import Attitude, LevelledSamples
from app.engine.inertial.pedestrian import PedestrianState
from app.engine.types import DeviceCalibration, Prior

VERSION = 1


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
    a, tail = state.attitude, state.tail
    return {
        "attitude": [a.t, *a.q, a.heading], "last_step_t": state.last_step_t,
        "t": tail.t, "mag": tail.mag, "heading": tail.heading, "vertical": tail.vertical,
    }  # fmt: skip


def pedestrian_state(values: dict[str, Any]) -> PedestrianState:
    """Inverse of :func:`pedestrian_values`."""
    t, w, x, y, z, heading = values["attitude"]
    tail = LevelledSamples(values["t"], values["mag"], values["heading"], values["vertical"])
    return PedestrianState(Attitude(t, (w, x, y, z), heading), values["last_step_t"], tail)


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
    )


def _encode(value: object) -> dict[str, Any]:
    if isinstance(value, np.ndarray):
        return {"__nd__": value.dtype.str, "shape": list(value.shape), "data": value.tobytes()}
    raise TypeError(f"cannot encode {type(value).__name__}")


def _decode(value: dict[str, Any]) -> Any:
    if "__nd__" in value:
        return np.frombuffer(value["data"], dtype=value["__nd__"]).reshape(value["shape"]).copy()
    return value
