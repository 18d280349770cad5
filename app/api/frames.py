"""Body frames of uploads, taken to the engine's: Android, x right, y to the top edge (forward), z out of the screen.

Each is a proper rotation (determinant +1), so that rates turn like fields; ``ios`` has Android's axes, but Apple's
accelerometer reads gravity as pointing down (-9.81 on z for a phone lying face up), so its sign is turned. Units are
never converted: m/s^2 also from iOS, whose raw unit is g.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from app.api.schemas.samples import Frame
from app.engine.types import Float64Array


@dataclass(frozen=True, slots=True)
class FrameRule:
    """Android's axes in terms of the frame's: ``out[i] = sign[i] * in[axis[i]]``; ``acc_sign`` on top for the
    accelerometer."""

    axis: tuple[int, int, int]
    sign: tuple[float, float, float]
    acc_sign: float = 1.0


RULES: Mapping[Frame, FrameRule] = {
    Frame.ANDROID: FrameRule((0, 1, 2), (1.0, 1.0, 1.0)),
    Frame.IOS: FrameRule((0, 1, 2), (1.0, 1.0, 1.0), acc_sign=-1.0),
    Frame.FRD: FrameRule((1, 0, 2), (1.0, 1.0, -1.0)),
    Frame.FLU: FrameRule((1, 0, 2), (-1.0, 1.0, 1.0)),
}


def to_android(columns: Float64Array, frame: Frame, *, specific_force: bool = False) -> Float64Array:
    """Turn columns of shape (3, n) into rows of shape (n, 3) in Android's frame."""
    rule = RULES[frame]
    sign = np.array(rule.sign) * (rule.acc_sign if specific_force else 1.0)
    # + 0.0 turns -0.0 into 0.0, so that equal readings have equal bytes and hashes
    turned: Float64Array = np.ascontiguousarray(columns[list(rule.axis)].T * sign + 0.0)
    return turned
