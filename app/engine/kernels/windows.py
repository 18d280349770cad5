"""Means over windows of unevenly timed samples."""

import numpy as np
from numba import njit


@njit(cache=True, nogil=True, error_model="numpy")
def pauta_means(values, lo, hi, out):
    """Mean of each window, channel by channel, without what lies beyond three standard deviations.

    Parameters
    ----------
    values : (n, channels)
    lo, hi : (windows,) first row of each window and the row after its last; ``hi > lo``
    out : (windows, channels)
    """
    for w in range(lo.shape[0]):
        count = hi[w] - lo[w]
        for c in range(values.shape[1]):
            total = 0.0
            for i in range(lo[w], hi[w]):
                total += values[i, c]
            mean = total / count
            squares = 0.0
            for i in range(lo[w], hi[w]):
                squares += (values[i, c] - mean) ** 2
            bound = 3.0 * np.sqrt(squares / count)
            kept, total = 0, 0.0
            for i in range(lo[w], hi[w]):
                if abs(values[i, c] - mean) <= bound:
                    kept += 1
                    total += values[i, c]
            out[w, c] = total / kept if kept > 0 else mean
