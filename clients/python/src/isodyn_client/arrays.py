"""Arrays of uploads: whatever numpy understands goes in, float64 of the right shape comes out."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Float64Array = NDArray[np.float64]


def store(target: object, name: str, value: object) -> None:
    """Set a field of a frozen dataclass while it is made."""
    object.__setattr__(target, name, value)


def _array(value: ArrayLike) -> NDArray[Any]:
    return np.asarray(value, dtype=np.float64)


def vector(name: str, value: ArrayLike, length: int | None = None) -> Float64Array:
    """``value`` as float64 of shape (length,), any length if None; ValueError names the field otherwise."""
    array = _array(value)
    if array.ndim != 1 or (length is not None and len(array) != length):
        raise ValueError(f"{name} needs shape ({'n' if length is None else length},), got {array.shape}")
    return array


def triples(name: str, value: ArrayLike, length: int) -> Float64Array:
    """``value`` as float64 of shape (length, 3); ValueError names the field otherwise."""
    array = _array(value)
    if array.shape != (length, 3):
        raise ValueError(f"{name} needs shape ({length}, 3), one row a sample, got {array.shape}")
    return array
