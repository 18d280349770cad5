"""A small level with a known field, and walks through it: enough of the world to run the whole service.

The field is a sum of plane waves of a few metres; a walk goes along straight legs at 1.2 m/s with two steps a second,
the phone held flat and pointing ahead.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from app.engine.types import Float64Array, ImuSamples, SurveyWalk, Waypoints

RATE_HZ = 50.0
SPEED = 1.2
STEP_HZ = 1.9
WIDTH, HEIGHT = 24.0, 12.0
EXTENT = (-2.0, -2.0, WIDTH + 2.0, HEIGHT + 2.0)

Point = tuple[float, float]


def field_at(x: Float64Array, y: Float64Array) -> Float64Array:
    """Field in the level frame, shape (n, 3), uT."""
    rng = np.random.default_rng(7)
    field = np.tile([3.0, 30.0, -38.0], (x.shape[0], 1))
    for _ in range(24):
        angle, wave = rng.uniform(0.0, np.pi), rng.uniform(3.0, 9.0)
        phase = rng.uniform(0.0, 2.0 * np.pi)
        wave_at = np.sin(2.0 * np.pi * (x * np.cos(angle) + y * np.sin(angle)) / wave + phase)
        field += wave_at[:, None] * rng.normal(0.0, 1.8, 3)
    return field


@dataclass(frozen=True)
class Walk:
    """Samples and the truth."""

    samples: ImuSamples
    x: Float64Array
    y: Float64Array
    waypoints: Waypoints

    def survey(self, walk_id: str) -> SurveyWalk:
        return SurveyWalk(walk_id, self.samples, self.waypoints)


def walk(corners: Sequence[Point], *, t0: float, seed: int) -> Walk:
    """Walk along the corners; turns take a second, waypoints are at the corners."""
    rng = np.random.default_rng(seed)
    x, y, heading, moving, at = _path(corners)
    n = x.shape[0]
    t = t0 + np.arange(n) / RATE_HZ
    ahead = heading - np.pi / 2.0  # rotation of the body's y axis, which points ahead
    field = field_at(x, y) + rng.normal(0.0, 0.3, (n, 3))
    mag = np.stack(
        [
            np.cos(ahead) * field[:, 0] + np.sin(ahead) * field[:, 1],
            -np.sin(ahead) * field[:, 0] + np.cos(ahead) * field[:, 1],
            field[:, 2],
        ],
        axis=1,
    )
    acc = rng.normal(0.0, 0.1, (n, 3))
    acc[:, 2] += 9.81 + moving * 2.5 * np.sin(2.0 * np.pi * STEP_HZ * np.arange(n) / RATE_HZ)
    gyro = rng.normal(0.0, 0.01, (n, 3))
    gyro[:, 2] += np.gradient(np.unwrap(heading), 1.0 / RATE_HZ)
    marks = np.array(at)
    return Walk(ImuSamples(t, mag, acc, gyro), x, y, Waypoints(t[marks], x[marks], y[marks]))


def _path(corners: Sequence[Point]) -> tuple[Float64Array, Float64Array, Float64Array, Float64Array, list[int]]:
    legs: list[tuple[Float64Array, Float64Array, Float64Array, float]] = []
    at = [0]
    heading = _bearing(corners[0], corners[1])
    for start, end in itertools.pairwise(corners):
        new = heading + (_bearing(start, end) - heading + np.pi) % (2.0 * np.pi) - np.pi
        if new != heading:
            turn = np.linspace(heading, new, int(RATE_HZ))
            legs.append((np.full(turn.shape, start[0]), np.full(turn.shape, start[1]), turn, 0.0))
            heading = new
        n = int(np.hypot(end[0] - start[0], end[1] - start[1]) / SPEED * RATE_HZ)
        legs.append((np.linspace(start[0], end[0], n), np.linspace(start[1], end[1], n), np.full(n, heading), 1.0))
        at.append(sum(leg[0].shape[0] for leg in legs) - 1)
    x, y, headings = (np.concatenate([leg[i] for leg in legs]) for i in range(3))
    moving = np.concatenate([np.full(leg[0].shape, leg[3]) for leg in legs])
    return x, y, headings, moving, at


def _bearing(start: Point, end: Point) -> float:
    return float(np.arctan2(end[1] - start[1], end[0] - start[0]))


def survey_walks() -> list[Walk]:
    """Aisles of 1.5 m, walked there and back."""
    rows = np.arange(0.0, HEIGHT + 0.1, 1.5)
    columns = np.arange(0.0, WIDTH + 0.1, 3.0)
    across = [corner for row in rows for corner in ((0.0, float(row)), (WIDTH, float(row)))]
    along = [corner for column in columns for corner in ((float(column), 0.0), (float(column), HEIGHT))]
    return [walk(across, t0=1.7e9, seed=1), walk(along, t0=1.7e9 + 1000.0, seed=2)]


def trip(seed: int, *, t0: float, laps: int = 2) -> Walk:
    """Laps around a rectangle that differs from seed to seed."""
    rng = np.random.default_rng(seed)
    left, bottom = rng.uniform(1.0, 6.0), rng.uniform(1.0, 4.0)
    right, top = rng.uniform(14.0, 23.0), rng.uniform(7.0, 11.0)
    lap = [(left, bottom), (right, bottom), (right, top), (left, top)]
    return walk([*(lap * laps), lap[0]], t0=t0, seed=100 + seed)
