"""Raw streams made fit for use: one time base, means without outliers."""

from __future__ import annotations

import numpy as np

from app.engine.errors import InputError
from app.engine.kernels.windows import pauta_means
from app.engine.types import Float64Array, ImuSamples

MAX_GAP_S = 1.0


def common_time_base(
    mag_t: Float64Array,
    mag: Float64Array,
    acc_t: Float64Array,
    acc: Float64Array,
    gyro_t: Float64Array,
    gyro: Float64Array,
) -> ImuSamples:
    """Asynchronous streams on the magnetometer's times, where all three are heard.

    Accelerometer and gyroscope are interpolated linearly: they run at least as fast as the magnetometer, whose
    readings stay as they are.

    Parameters
    ----------
    mag_t, acc_t, gyro_t : arrays, shapes (n,), (m,), (k,), s, strictly increasing
    mag, acc, gyro : arrays, shapes (n, 3), (m, 3), (k, 3); uT, m/s^2, rad/s; body frame

    Raises
    ------
    InputError
        A stream is empty or out of order, has a gap over a second, or the streams do not overlap.
    """
    for name, t in (("mag", mag_t), ("acc", acc_t), ("gyro", gyro_t)):
        if t.shape[0] < 2 or not np.all(np.diff(t) > 0):
            raise InputError(f"{name}.t", "needs at least two times, strictly increasing")
        if np.diff(t).max() > MAX_GAP_S:
            raise InputError(f"{name}.t", f"has a gap of {np.diff(t).max():.1f} s; split the recording there")
    heard = (mag_t >= max(acc_t[0], gyro_t[0])) & (mag_t <= min(acc_t[-1], gyro_t[-1]))
    if not heard.any():
        raise InputError("mag.t", "does not overlap the other streams; are all on one clock?")
    t = mag_t[heard]
    return ImuSamples(t, mag[heard], _interpolate(t, acc_t, acc), _interpolate(t, gyro_t, gyro))


def window_means(t: Float64Array, values: Float64Array, begin: Float64Array, end: Float64Array) -> Float64Array:
    """Mean of ``values`` over each window, by the Pauta criterion: readings beyond three standard deviations left out.

    A passing spike (a magnet, a dropped bit) would else move the mean of a whole step (S3, section 1).

    Parameters
    ----------
    t : array, shape (n,), s, increasing
    values : array, shape (n, channels)
    begin, end : arrays, shape (k,), s
        Closed windows; the nearest sample stands for a window without any.

    Returns
    -------
    array, shape (k, channels)
    """
    lo = np.minimum(np.searchsorted(t, begin - 1e-9), t.shape[0] - 1)
    hi = np.maximum(np.searchsorted(t, end + 1e-9, side="right"), lo + 1)
    out = np.empty((begin.shape[0], values.shape[1]))
    pauta_means(np.ascontiguousarray(values), lo, hi, out)
    return out


def _interpolate(at: Float64Array, t: Float64Array, values: Float64Array) -> Float64Array:
    return np.stack([np.interp(at, t, values[:, axis]) for axis in range(3)], axis=1)
