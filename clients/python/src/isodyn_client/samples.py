"""What is uploaded: samples of a device, labelled positions. numpy in."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from isodyn_client.arrays import Float64Array, store, triples, vector

SEGMENT_S = 5.0
"""Length of a segment when nothing else is asked for, s."""


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
        store(self, "t_ms", vector("t_ms", self.t_ms))
        for name in ("mag", "acc", "gyro"):
            store(self, name, triples(name, getattr(self, name), len(self.t_ms)))

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
        store(self, "t_ms", vector("t_ms", self.t_ms))
        for name in ("x", "y"):
            store(self, name, vector(name, getattr(self, name), len(self.t_ms)))

    def __len__(self) -> int:
        return len(self.t_ms)
