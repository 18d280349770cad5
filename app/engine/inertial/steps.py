"""Steps from vertical specific force.

Everything is decided from samples within ``SETTLE_S`` after a peak and ``MEMORY_S`` before it, so cutting a recording
into segments does not change its steps. (At a coarse rate add two samples on either side: the interpolation's reach.)
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from app.engine.inertial.attitude import level_samples
from app.engine.types import Float64Array, ImuSamples

MIN_INTERVAL_S = 0.33
MIN_SWING = 1.2
"""m/s^2 between the peak and the lowest value in the ``SWING_S`` before it."""
SWING_S = 0.5
SMOOTH_S = 0.12
"""Half width of the smoothing window."""
PEAK_S = 0.2
"""A step is the highest value within this time on either side."""
COARSE_S = 0.03
"""From this median interval on samples miss the peaks; they are interpolated every ``FINE_S`` first."""
FINE_S = 0.02
COARSE_MIN_SWING = 0.8
"""m/s^2: what little a coarse rate and the filters before it leave of a gentle walker's step."""
SETTLE_S = PEAK_S + SMOOTH_S
MEMORY_S = SWING_S + SMOOTH_S + PEAK_S


def settled_until(t: Float64Array) -> float:
    """Time up to which the steps of samples at ``t`` are final."""
    return float(max(t[-1] - SETTLE_S, t[0]))


@dataclass(frozen=True, slots=True)
class Steps:
    """Steps of a stretch: times ``t`` (n,) s and ``swing`` (n,) m/s^2, the vertical swing that measures stride."""

    t: Float64Array
    swing: Float64Array

    def __len__(self) -> int:
        return int(self.t.shape[0])


def find_steps(t: Float64Array, vertical: Float64Array, *, after: float = -np.inf) -> Steps:
    """Steps after time ``after``, up to ``SETTLE_S`` before the last sample.

    Parameters
    ----------
    t : array, shape (n,), s
    vertical : array, shape (n,), m/s^2
        Specific force along the vertical.
    after : float, s
        Time of the last step known already; the next is at least ``MIN_INTERVAL_S`` later.
    """
    min_swing = MIN_SWING
    if t.shape[0] >= 4 and np.median(np.diff(t)) > COARSE_S:
        min_swing = COARSE_MIN_SWING
        t, vertical = _interpolate_finely(t, vertical)
    if t.shape[0] < 3:
        return Steps(np.empty(0), np.empty(0))
    smooth = _smooth(t, vertical)
    inner = np.flatnonzero((smooth[1:-1] >= smooth[:-2]) & (smooth[1:-1] > smooth[2:])) + 1
    times: list[float] = []
    swings: list[float] = []
    for i in inner:
        if t[i] < after + MIN_INTERVAL_S or t[i] > t[-1] - SETTLE_S:
            continue
        around = slice(np.searchsorted(t, t[i] - PEAK_S), np.searchsorted(t, t[i] + PEAK_S, side="right"))
        before = slice(np.searchsorted(t, t[i] - SWING_S), i + 1)
        swing = smooth[i] - smooth[before].min()
        if smooth[i] >= smooth[around].max() and swing >= min_swing:
            times.append(float(t[i]))
            swings.append(float(swing))
            after = float(t[i])
    return Steps(np.array(times), np.array(swings))


def _interpolate_finely(t: Float64Array, v: Float64Array) -> tuple[Float64Array, Float64Array]:
    """Cubic interpolation at multiples of ``FINE_S`` within the second and the last but one sample.

    A value depends on two samples on either side of it and on nothing else, the times on none, so pieces of a recording
    give pieces of the same result.
    """
    fine = FINE_S * np.arange(np.ceil(t[1] / FINE_S), np.floor(t[-2] / FINE_S) + 1)
    left = np.clip(np.searchsorted(t, fine, side="right") - 1, 1, len(t) - 3)
    slope = np.gradient(v, t)
    step = t[left + 1] - t[left]
    u = (fine - t[left]) / step
    # cubic Hermite basis: value and slope at the left sample, then at the right one
    value: Float64Array = (
        (1 + 2 * u) * (1 - u) ** 2 * v[left]
        + u * (1 - u) ** 2 * step * slope[left]
        + u**2 * (3 - 2 * u) * v[left + 1]
        - u**2 * (1 - u) * step * slope[left + 1]
    )
    return fine, value


def detect_steps(samples: ImuSamples) -> Float64Array:
    """Step times of a whole recording, shape (n,), s."""
    levelled, _ = level_samples(samples)
    return find_steps(levelled.t, levelled.vertical).t


def _smooth(t: Float64Array, v: Float64Array) -> Float64Array:
    """Mean over ``SMOOTH_S`` on either side, twice as heavy in the middle half; works on uneven time."""
    total = np.concatenate(([0.0], np.cumsum(v)))
    result = np.zeros_like(v)
    for half, weight in ((SMOOTH_S, 0.5), (SMOOTH_S / 2, 0.5)):
        lo = np.searchsorted(t, t - half - 1e-9)
        hi = np.searchsorted(t, t + half + 1e-9, side="right")
        result += weight * (total[hi] - total[lo]) / (hi - lo)
    return result
