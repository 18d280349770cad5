"""Fields as words of 16 bits, for the kernels that work on twice as many numbers at a time."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from app.engine.types import Float64Array

QUANTUM_UT = 0.1
"""uT: a tenth of what a phone's readings scatter by."""


def quantize(values: Float64Array, low: Float64Array) -> NDArray[np.uint16]:
    """Values in quanta above ``low``, at 0 and 65535 where they lie outside.

    Only differences are ever taken, so query and map need the same ``low``, a value below both.

    Parameters
    ----------
    values : array, shape (..., channels), uT
    low : array, shape (channels,), uT
    """
    return np.clip(np.rint((values - low) / QUANTUM_UT), 0, 65535).astype(np.uint16)
