"""Fields that cannot be the building's: magnets, passing vehicles, lift doors, a saturated sensor."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from app.engine.inertial.attitude import LevelledSamples
from app.engine.types import BoolArray, Float64Array

RANGE_UT = (5.0, 150.0)
"""Magnitudes that occur beside the steel of buildings, with a platform's calibration error on top."""
RATE_UT_S = 50.0
"""Change of magnitude that walking past steel explains: all but 0.3 % of the steps of the survey walks stay below."""
WALKING_M_S = 1.3
"""Whoever is faster passes the same steel in less time."""
_SMOOTH_S = 0.08
"""Half width of a mean, against the coarse steps of magnetometers."""
_LAG_S = 0.2


def disturbed(
    levelled: LevelledSamples, mag: Float64Array, begin: Float64Array, end: Float64Array, speed: Float64Array
) -> BoolArray:
    """Whether the field at each step cannot be the building's: shape (k,).

    Parameters
    ----------
    levelled : LevelledSamples
        From 0.3 s before the first step's beginning to 0.1 s after the last one's end.
    mag : array, shape (k, 3), uT
        Field at the steps.
    begin, end : arrays, shape (k,), s
        Time over which a step's field is looked at.
    speed : array, shape (k,), m/s
    """
    magnitude = np.linalg.norm(mag, axis=1)
    outside = (magnitude < RANGE_UT[0]) | (magnitude > RANGE_UT[1])
    bound = RATE_UT_S * np.maximum(speed / WALKING_M_S, 1.0)
    found: BoolArray = outside | (_steepest(levelled, begin, end) > bound)
    return found


@dataclass(frozen=True, slots=True)
class Calm:
    """Field (free azimuth, uT) of the last step that was not disturbed; ``passing`` while disturbed ones follow it."""

    x: float
    y: float
    z: float
    passing: bool = False


def shifts(
    calm: Calm | None, mag: Float64Array, heading: Float64Array, flags: BoolArray
) -> tuple[Calm | None, Float64Array]:
    """What disturbances have left behind, shape (k,), uT.

    A magnet that came to stay (a mount, a case) disturbs a step or two; from then on it is an offset. At the first step
    after a disturbance this tells how far the field is from what it was before; elsewhere it is 0.

    Parameters
    ----------
    calm : Calm or None
        After the steps before.
    mag : array, shape (k, 3), uT
        Forward, left, up.
    heading : array, shape (k,), rad
        Of the device, free azimuth.
    flags : array, shape (k,), bool
        From :func:`disturbed`.
    """
    left = np.zeros(len(flags))
    level = (mag[:, 0] + 1j * mag[:, 1]) * np.exp(1j * heading)
    for i, (x, y, z) in enumerate(zip(level.real.tolist(), level.imag.tolist(), mag[:, 2].tolist(), strict=True)):
        if flags[i]:
            calm = None if calm is None else Calm(calm.x, calm.y, calm.z, passing=True)
            continue
        if calm is not None and calm.passing:
            left[i] = math.hypot(x - calm.x, y - calm.y, z - calm.z)
        calm = Calm(x, y, z)
    return calm, left


def _steepest(levelled: LevelledSamples, begin: Float64Array, end: Float64Array) -> Float64Array:
    """Fastest change of the smoothed magnitude over ``_LAG_S`` within each window, uT/s."""
    t, m = levelled.t, levelled.mag
    total = np.concatenate(([0.0], np.cumsum(np.sqrt(m[:, 0] ** 2 + m[:, 1] ** 2 + m[:, 2] ** 2))))
    lo = np.searchsorted(t, t - _SMOOTH_S - 1e-9)
    hi = np.searchsorted(t, t + _SMOOTH_S + 1e-9, side="right")
    smooth = (total[hi] - total[lo]) / (hi - lo)
    later = np.minimum(np.searchsorted(t, t + _LAG_S - 1e-9), len(t) - 1)
    rate = np.abs(smooth[later] - smooth) / np.maximum(t[later] - t, _LAG_S)
    first = np.searchsorted(t, begin - _LAG_S).tolist()
    last = np.searchsorted(t, end - _LAG_S, side="right").tolist()
    return np.array([rate[i:j].max(initial=0.0) for i, j in zip(first, last, strict=True)], dtype=np.float64)
