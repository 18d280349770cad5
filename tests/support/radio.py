"""A simulated hall with access points of known place and power."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from app.engine.mapping.samples import PlacedSamples
from app.engine.types import Float64Array, ImuSamples, RadioMap, RadioScans, SurveyWalk, Waypoints

EXTENT = (0.0, 0.0, 60.0, 40.0)
SCAN_S = 2.0
SPEED_M_S = 1.2


@dataclass(frozen=True)
class Hall:
    """Access points at ``at`` (k, 2) with ``power`` dBm at 1 m; readings scatter by ``noise`` dB."""

    at: Float64Array
    power: Float64Array
    address: tuple[str, ...]
    noise: float = 3.0
    least: float = -85.0

    @classmethod
    def random(cls, rng: np.random.Generator, n: int = 30, *, storey: int = 0) -> Hall:
        at = np.stack([rng.uniform(EXTENT[0], EXTENT[2], n), rng.uniform(EXTENT[1], EXTENT[3], n)], axis=1)
        return cls(at, rng.uniform(-45, -35, n), tuple(f"0{storey}:00:00:00:{i:02x}:a0" for i in range(n)))

    def strength(self, xy: Float64Array) -> Float64Array:
        """Expected strength at (m, 2), shape (m, k)."""
        distance = np.hypot(xy[:, None, 0] - self.at[:, 0], xy[:, None, 1] - self.at[:, 1])
        return self.power - 30.0 * np.log10(np.maximum(distance, 2.0))

    def scans(self, t: Float64Array, xy: Float64Array, rng: np.random.Generator, *, gain: float = 0.0) -> RadioScans:
        """One scan at each time; weak transmitters are not reported."""
        level = self.strength(xy)
        rssi = level + self.noise * rng.standard_normal(level.shape)
        row, column = np.nonzero(rssi > self.least)
        when = t[row] + rng.uniform(0.0, 0.2, len(row))
        order = np.argsort(when)
        names = tuple(self.address[i] for i in column[order])
        return RadioScans(when[order], names, np.round(rssi[row, column][order] + gain))


def survey_line(walk_id: str, ends: Sequence[Sequence[float]], t0: float = 0.0) -> tuple[SurveyWalk, PlacedSamples]:
    """A straight survey walk, already placed; without radio."""
    a, b = np.array(ends, dtype=float)
    duration = float(np.hypot(*(b - a))) / SPEED_M_S
    t = t0 + np.arange(0.0, duration, 0.3)
    xy = a + (b - a) * ((t - t0) / duration)[:, None]
    empty = np.zeros((len(t), 3))
    walk = SurveyWalk(
        walk_id, ImuSamples(t, empty, empty, empty), Waypoints(t[[0, -1]], xy[[0, -1], 0], xy[[0, -1], 1])
    )
    return walk, PlacedSamples(walk_id, t, xy, np.zeros(len(t)), empty)


def lawn(spacing_m: float = 4.0) -> list[tuple[SurveyWalk, PlacedSamples]]:
    """Lines across the whole hall, both ways."""
    across = [((2.0, y), (58.0, y)) for y in np.arange(2.0, 39.0, spacing_m)]
    along = [((x, 2.0), (x, 38.0)) for x in np.arange(2.0, 59.0, 2.0 * spacing_m)]
    return [survey_line(f"line-{i}", ends, 1000.0 * i) for i, ends in enumerate(across + along)]


def nodes(radio: RadioMap) -> Float64Array:
    """Positions of the nodes, shape (rows * columns, 2)."""
    rows, columns = radio.mean.shape[1:]
    xx, yy = np.meshgrid(radio.x0 + radio.cell_m * np.arange(columns), radio.y0 + radio.cell_m * np.arange(rows))
    return np.stack([xx.ravel(), yy.ravel()], axis=1)
