"""Fields that cannot be the building's: magnets, passing vehicles, lift doors, a saturated sensor."""

from __future__ import annotations

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
        From ``_SMOOTH_S`` before the first step's beginning to as much after the last one's end.
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


def _steepest(levelled: LevelledSamples, begin: Float64Array, end: Float64Array) -> Float64Array:
    """Fastest change of the smoothed magnitude over ``_LAG_S`` within each window, uT/s."""
    t, m = levelled.t, levelled.mag
    total = np.concatenate(([0.0], np.cumsum(np.sqrt(m[:, 0] ** 2 + m[:, 1] ** 2 + m[:, 2] ** 2))))
    lo = np.searchsorted(t, t - _SMOOTH_S - 1e-9)
    hi = np.searchsorted(t, t + _SMOOTH_S + 1e-9, side="right")
    smooth = (total[hi] - total[lo]) / (hi - lo)
    later = np.minimum(np.searchsorted(t, t + _LAG_S - 1e-9), len(t) - 1)
    rate = np.abs(smooth[later] - smooth) / np.maximum(t[later] - t, _LAG_S)
    first = np.searchsorted(t, begin).tolist()
    last = np.searchsorted(t, end - _LAG_S, side="right").tolist()
    return np.array([rate[i:j].max(initial=0.0) for i, j in zip(first, last, strict=True)], dtype=np.float64)
