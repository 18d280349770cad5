"""Array and callback types."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Float64Array = NDArray[np.float64]
IntArray = NDArray[np.int64]
ComplexArray = NDArray[np.complex128]
Float32Array = NDArray[np.float32]
BoolArray = NDArray[np.bool_]
Progress = Callable[[float, str], None]
"""``progress(fraction, what)``: called now and then with 0..1 and a short phrase."""
Int8Array = NDArray[np.int8]
Int16Array = NDArray[np.int16]
Int32Array = NDArray[np.int32]
UInt8Array = NDArray[np.uint8]
