"""The field measured along a session's track, and its raw samples."""

from __future__ import annotations

import math
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from app.api.schemas.base import Out, example
from app.api.schemas.devices import CALIBRATION_EXAMPLE, CalibrationOut
from app.api.schemas.fixes import t_ms
from app.api.schemas.levels import LEVEL_ID
from app.api.schemas.sessions import SESSION_ID
from app.engine.localization.field_profile import CHANNELS
from app.engine.types import Float64Array
from app.services.session_samples import SessionProfile

_DIGITS = 3


class ChannelsOut(Out):
    """A column a component, uT: intensity, horizontal magnitude, vertical component (up); null: not known there."""

    total: list[float | None]
    h: list[float | None]
    v: list[float | None]


_EXAMPLE: dict[str, Any] = {
    "session_id": SESSION_ID,
    "number": [0],
    "t_ms": [1764000004980.0],
    "x": [12.31],
    "y": [4.07],
    "level_id": [LEVEL_ID],
    "measured": {"total": [48.61], "h": [22.4], "v": [-43.14]},
    "mapped": {"total": [49.02], "h": [21.97], "v": [-43.82]},
    "sd": {"total": [1.2], "h": [0.9], "v": [1.1]},
    "calibration": CALIBRATION_EXAMPLE,
    "learned": True,
}


class ProfileOut(Out):
    """Measured and mapped field at the positions of a session, in columns."""

    model_config = example(_EXAMPLE)

    session_id: str
    number: Annotated[list[int], Field(description="Of the fix, as in its positions.")]
    t_ms: list[float]
    x: Annotated[list[float], Field(description="m, level frame.")]
    y: list[float]
    level_id: list[str]
    measured: Annotated[ChannelsOut, Field(description="Mean over a step, levelled by gravity, without `calibration`.")]
    mapped: Annotated[ChannelsOut, Field(description="Of the session's map, at the fix.")]
    sd: Annotated[ChannelsOut, Field(description="What the two may differ by: of the map, and of a reading.")]
    calibration: Annotated[
        CalibrationOut | None,
        Field(description="Taken off what was measured: what the session learned of its device, or started with."),
    ]
    learned: Annotated[bool, Field(description="Whether the session itself found it out.")]


def profile_object(profile: SessionProfile) -> dict[str, Any]:
    """Return a profile as plain values, the shape of ProfileOut."""
    fixes = [position.fix for position in profile.positions]
    known = profile.calibration and CalibrationOut.of(profile.calibration).model_dump()
    return {
        "session_id": profile.session_id,
        "number": [position.number for position in profile.positions],
        "t_ms": [t_ms(fix) for fix in fixes],
        "x": [round(fix.x, _DIGITS) for fix in fixes],
        "y": [round(fix.y, _DIGITS) for fix in fixes],
        "level_id": [fix.level_id for fix in fixes],
        "measured": _channels(profile.field.measured),
        "mapped": _channels(profile.field.mapped),
        "sd": _channels(profile.field.sd),
        "calibration": known,
        "learned": profile.learned,
    }


def _channels(rows: Float64Array) -> dict[str, list[float | None]]:
    """NaN is null: JSON has no other word for it."""
    return {
        name: [None if math.isnan(value) else value for value in np.round(row, _DIGITS).tolist()]
        for name, row in zip(CHANNELS, rows, strict=True)
    }
