"""Stride length from the vertical swing of a step."""

from __future__ import annotations

import numpy as np

from app.engine.types import Float64Array

WEINBERG = 0.425
"""m / (m/s^2)^(1/4), the median of 559 survey walks; single walks differ by 13 % (one standard deviation), which the
stride scale of a filter learns."""
SPREAD = 0.13
MEAN_SWING = 6.4
"""m/s^2, the median step of the same walks: a stride of 0.68 m."""
_RANGE_M = (0.3, 1.1)


def weinberg(swing: Float64Array, constant: float = WEINBERG) -> Float64Array:
    """Stride ``constant * swing**(1/4)`` (Weinberg, Analog Devices AN-602, 2002), m; kept within human range."""
    stride: Float64Array = np.clip(constant * np.maximum(swing, 0.0) ** 0.25, *_RANGE_M)
    return stride
