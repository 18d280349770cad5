"""What is uploaded: samples of a device, Wi-Fi readings, labelled positions. numpy in."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Float64Array = NDArray[np.float64]

SEGMENT_S = 5.0
"""Length of a segment when nothing else is asked for, s."""


@dataclass(frozen=True, slots=True, eq=False)
class WifiScans:
    """Wi-Fi readings: one row per access point seen.

    Parameters
    ----------
    t_ms : array, shape (m,), Unix ms
        When the access point was last heard, in any order.
    bssid : sequence of str, length m
    rssi : array, shape (m,), dBm
    """

    t_ms: Float64Array
    bssid: Sequence[str]
    rssi: Float64Array

    def __post_init__(self) -> None:
        _store(self, "t_ms", _vector("t_ms", self.t_ms))
        _store(self, "bssid", tuple(self.bssid))
        _store(self, "rssi", _vector("rssi", self.rssi, len(self.t_ms)))
        if len(self.bssid) != len(self.t_ms):
            raise ValueError(f"bssid needs {len(self.t_ms)} entries, got {len(self.bssid)}")

    def __len__(self) -> int:
        return len(self.t_ms)

    def between(self, start_ms: float, stop_ms: float) -> WifiScans:
        """Readings with ``start_ms <= t_ms < stop_ms``."""
        keep = (self.t_ms >= start_ms) & (self.t_ms < stop_ms)
        bssid = tuple(name for name, kept in zip(self.bssid, keep, strict=True) if kept)
        return WifiScans(self.t_ms[keep], bssid, self.rssi[keep])


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """Magnetometer and inertial samples on one time base.

    Arrays of any float type, lists or tuples are taken; they are kept as float64. Only shapes are
    checked here: whether the values make sense is the service's to say, which names the field and the remedy.

    Parameters
    ----------
    t_ms : array, shape (n,), Unix ms
        Strictly increasing; fractions are kept.
    mag : array, shape (n, 3), uT
    acc : array, shape (n, 3), m/s^2
        Gravity included: lying flat and at rest, an Android phone reads about (0, 0, +9.8).
    gyro : array, shape (n, 3), rad/s
    frame : str
        Axes of the sensors: ``android`` (x right, y to the top edge, z out of the screen), ``ios``, ``frd``, ``flu``.

    Raises
    ------
    ValueError
        When shapes do not fit.
    """

    t_ms: Float64Array
    mag: Float64Array
    acc: Float64Array
    gyro: Float64Array
    frame: str = "android"

    def __post_init__(self) -> None:
        _store(self, "t_ms", _vector("t_ms", self.t_ms))
        for name in ("mag", "acc", "gyro"):
            _store(self, name, _triples(name, getattr(self, name), len(self.t_ms)))

    def __len__(self) -> int:
        return len(self.t_ms)

    def __getitem__(self, rows: slice) -> Samples:
        return Samples(self.t_ms[rows], self.mag[rows], self.acc[rows], self.gyro[rows], self.frame)

    @property
    def duration_s(self) -> float:
        """Time from the first to the last sample, s."""
        return float(self.t_ms[-1] - self.t_ms[0]) / 1000.0 if len(self) else 0.0

    def split(self, segment_s: float = SEGMENT_S) -> Iterator[Samples]:
        """Cut into pieces of ``segment_s`` seconds (the last one may be shorter)."""
        if segment_s <= 0:
            raise ValueError(f"segment_s must be positive, got {segment_s}")
        if not len(self):
            return
        number = np.floor((self.t_ms - self.t_ms[0]) / (segment_s * 1000.0)).astype(np.int64)
        bounds = [0, *(np.flatnonzero(np.diff(number)) + 1).tolist(), len(self)]
        for start, stop in itertools.pairwise(bounds):
            yield self[start:stop]


@dataclass(frozen=True, slots=True, eq=False)
class Waypoints:
    """Labelled positions of a survey walk.

    Parameters
    ----------
    t_ms : array, shape (m,), Unix ms
        When each point was passed, strictly increasing.
    x, y : array, shape (m,), m
        Level frame.
    """

    t_ms: Float64Array
    x: Float64Array
    y: Float64Array

    def __post_init__(self) -> None:
        _store(self, "t_ms", _vector("t_ms", self.t_ms))
        for name in ("x", "y"):
            _store(self, name, _vector(name, getattr(self, name), len(self.t_ms)))

    def __len__(self) -> int:
        return len(self.t_ms)


def _store(target: object, name: str, value: object) -> None:
    object.__setattr__(target, name, value)


def _array(value: ArrayLike) -> NDArray[Any]:
    return np.asarray(value, dtype=np.float64)


def _vector(name: str, value: ArrayLike, length: int | None = None) -> Float64Array:
    array = _array(value)
    if array.ndim != 1 or (length is not None and len(array) != length):
        raise ValueError(f"{name} needs shape ({'n' if length is None else length},), got {array.shape}")
    return array


def _triples(name: str, value: ArrayLike, length: int) -> Float64Array:
    array = _array(value)
    if array.shape != (length, 3):
        raise ValueError(f"{name} needs shape ({length}, 3), one row a sample, got {array.shape}")
    return array
