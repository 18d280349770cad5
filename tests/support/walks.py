"""Simulated walks over a simulated field: truth is known, so claims can be tested."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from app.engine.types import FeatureSet, Float64Array, GridMap, ImuSamples, SurveyWalk, Waypoints

RATE_HZ = 50.0
STRIDE_M = 0.65
CADENCE_HZ = 1.8


@dataclass(frozen=True)
class Field:
    """Smooth random field about an inclined mean, as a sum of plane waves (uT, level frame)."""

    wave: Float64Array
    phase: Float64Array
    amplitude: Float64Array

    @classmethod
    def random(cls, rng: np.random.Generator, *, sd: float = 5.0, length_m: float = 4.0, waves: int = 200) -> Field:
        """Field with a Gaussian spectrum."""
        return cls(
            rng.standard_normal((waves, 2)) / length_m,
            rng.uniform(0, 2 * np.pi, waves),
            sd * np.sqrt(2.0 / waves) * rng.standard_normal((waves, 3)),
        )

    def at(self, xy: Float64Array) -> Float64Array:
        """Field at (n, 2), shape (n, 3)."""
        return np.cos(xy @ self.wave.T + self.phase) @ self.amplitude + [3.0, 30.0, -30.0]

    def with_errors(self, *others: Field) -> Field:
        """The sum of this field and what others differ by from their mean."""
        parts = (self, *others)
        return Field(
            *(np.concatenate([getattr(part, name) for part in parts]) for name in ("wave", "phase", "amplitude"))
        )


@dataclass(frozen=True)
class SimulatedWalk:
    """Samples with the truth behind them."""

    samples: ImuSamples
    xy: Float64Array
    heading: Float64Array

    def at(self, t: float) -> Float64Array:
        """True position at ``t``."""
        return np.array([np.interp(t, self.samples.t, self.xy[:, k]) for k in range(2)])


def walk_through(
    corners: Float64Array,
    field: Field,
    rng: np.random.Generator,
    *,
    hard_iron: Float64Array | None = None,
    soft_iron: Float64Array | None = None,
    carry: float = 0.0,
    noise_ut: float = 0.3,
    stride_m: float = STRIDE_M,
    t0: float = 1_700_000_000.0,
) -> SimulatedWalk:
    """A phone held flat, carried along straight legs between ``corners`` (n, 2) at an even pace.

    ``hard_iron`` (3,) uT is of the body, ``soft_iron`` (3, 3) of the levelled device (forward, left, up).
    """
    speed = stride_m * CADENCE_HZ
    legs = np.linalg.norm(np.diff(corners, axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(legs)])
    n = int(along[-1] / speed * RATE_HZ)
    t = np.arange(n) / RATE_HZ
    s = speed * t
    xy = np.stack([np.interp(s, along, corners[:, k]) for k in range(2)], axis=1)
    bearing = np.unwrap(np.arctan2(np.diff(corners[:, 1]), np.diff(corners[:, 0])))
    leg = np.clip(np.searchsorted(along, s, side="right") - 1, 0, len(bearing) - 1)
    kernel = np.hanning(41)
    padded = np.pad(bearing[leg], 20, mode="edge")
    heading = np.convolve(padded, kernel / kernel.sum(), mode="valid") + carry
    gyro = np.zeros((n, 3))
    gyro[:, 2] = np.gradient(heading, 1 / RATE_HZ)
    acc = np.zeros((n, 3))
    acc[:, 2] = 9.81 + 2.3 * np.sin(2 * np.pi * CADENCE_HZ * t)
    b = field.at(xy)
    c, d = np.cos(heading), np.sin(heading)
    forward, left = c * b[:, 0] + d * b[:, 1], -d * b[:, 0] + c * b[:, 1]
    levelled = np.stack([forward, left, b[:, 2]], axis=1)
    levelled = levelled if soft_iron is None else levelled @ (np.eye(3) + soft_iron).T
    mag = levelled[:, [1, 0, 2]] * [-1.0, 1.0, 1.0]  # body: x right, y forward, z up
    mag += (np.zeros(3) if hard_iron is None else hard_iron) + noise_ut * rng.standard_normal((n, 3))
    acc += 0.1 * rng.standard_normal((n, 3))
    gyro += 0.005 * rng.standard_normal((n, 3))
    return SimulatedWalk(ImuSamples(t0 + t, mag, acc, gyro), xy, heading)


def survey_of(walk: SimulatedWalk, walk_id: str, *, every_s: float = 5.0) -> SurveyWalk:
    """The walk as a survey: a waypoint every few seconds."""
    t = np.append(np.arange(walk.samples.t[0], walk.samples.t[-1] - 1.0, every_s), walk.samples.t[-1])
    xy = np.array([walk.at(at) for at in t])
    return SurveyWalk(walk_id, walk.samples, Waypoints(t, xy[:, 0], xy[:, 1]))


def true_map(
    field: Field,
    extent: tuple[float, float, float, float],
    *,
    cell_m: float = 0.5,
    sd: float = 0.5,
    noise: float = 1.0,
    level_id: str = "sim",
) -> GridMap:
    """The field itself as a map."""
    x = np.arange(extent[0], extent[2] + cell_m / 2, cell_m)
    y = np.arange(extent[1], extent[3] + cell_m / 2, cell_m)
    xx, yy = np.meshgrid(x, y)
    mean = field.at(np.stack([xx.ravel(), yy.ravel()], axis=1)).T.reshape(3, len(y), len(x))
    return GridMap(
        level_id=level_id,
        features=FeatureSet.VECTOR,
        x0=float(x[0]),
        y0=float(y[0]),
        cell_m=cell_m,
        mean=mean.astype(np.float32),
        sd=np.full(mean.shape, sd, dtype=np.float32),
        support=np.zeros(xx.shape, dtype=np.float32),
        mapped_m=1.5,
        noise_sd=(noise,) * 3,
    )


def cut(samples: ImuSamples, *, seconds: float) -> list[ImuSamples]:
    """Samples in segments."""
    edges = np.searchsorted(samples.t, np.arange(samples.t[0], samples.t[-1] + seconds, seconds))
    edges[-1] = len(samples)
    return [
        ImuSamples(samples.t[a:b], samples.mag[a:b], samples.acc[a:b], samples.gyro[a:b])
        for a, b in itertools.pairwise(edges)
        if b > a
    ]
