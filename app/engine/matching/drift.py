"""What the errors of dead reckoning grow like, read off the covariance that a track comes with."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls

from app.engine.matching.problem import Track
from app.engine.types import Float64Array

_MISSED = 0.05
"""Part of the last variance that is left to what the mixture does not hold: a constant that is none, a higher power."""


@dataclass(frozen=True, slots=True)
class DriftModel:
    """Variances of errors that add up to a track's covariance, per axis; time runs from 0 to 1 along the track.

    Attributes
    ----------
    dt : array, shape (n,)
        Normalized time since the point before; 0 for the first.
    walk : float, m^2
        Growth of the position's variance: white errors of steps.
    rate : float, m^2
        Variance of a constant rate of the error, as a wrong initial velocity makes it.
    rate_walk : float, m^2
        Growth of the rate's variance, as a gyro's or accelerometer's noise makes it.
    acceleration : float, m^2
        Variance of a constant change of the rate, as an accelerometer's bias makes it.
    """

    dt: Float64Array
    walk: float
    rate: float
    rate_walk: float
    acceleration: float

    @classmethod
    def of(cls, track: Track) -> DriftModel:
        """The non-negative mixture of ``t, t^2, t^3 / 3, t^4 / 4`` nearest to the mean variance of the two axes."""
        t = track.t - track.t[0] if len(track) else np.zeros(0)
        if len(t) < 2 or not np.all(np.diff(t) > 0.0):
            t = np.arange(len(track), dtype=np.float64)
        t = t / max(float(t[-1]), 1e-9) if len(t) else t
        variance = 0.5 * np.trace(track.cov, axis1=1, axis2=2)
        top = float(variance.max(initial=0.0))
        parts = np.zeros(4)
        if top > 0.0:
            basis = np.stack([t, t**2, t**3 / 3.0, t**4 / 4.0], axis=1)
            parts = nnls(basis, variance / top)[0] * top
        dt = np.concatenate([[0.0], np.diff(t)]) if len(t) else t
        walk, rate, rate_walk, acceleration = (float(part) for part in parts)
        return cls(dt, walk, rate, rate_walk + 3.0 * _MISSED * top, acceleration)
