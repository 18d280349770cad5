"""Simulated fields of places that cannot be recorded here: a yard for a cart, a garage lane, an office."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from app.engine.types import FeatureSet, Float64Array, GridMap

_WAVES = 200
_RIM_M = 2.0


@dataclass(frozen=True, slots=True)
class HarmonicField:
    """Field of distant sources below: minus the gradient of a sum of plane waves that decay upwards.

    Without divergence and curl, so its three components belong together as those of real steel do.

    Attributes
    ----------
    wave : array, shape (m, 2), rad/m
    phase : array, shape (m,), rad
    amplitude : array, shape (m,), uT
    mean : array, shape (3,), uT
        East, north, up.
    """

    wave: Float64Array
    phase: Float64Array
    amplitude: Float64Array
    mean: Float64Array

    def at(self, x: Float64Array, y: Float64Array) -> Float64Array:
        """Field at points, shape (n, 3), uT: x, y, up."""
        angle = x[:, None] * self.wave[:, 0] + y[:, None] * self.wave[:, 1] + self.phase
        direction = self.wave / np.hypot(*self.wave.T)[:, None]
        horizontal = (np.sin(angle) * self.amplitude) @ direction
        vertical = np.cos(angle) @ self.amplitude
        return np.concatenate([horizontal, vertical[:, None]], axis=1) + self.mean


def random_field(
    rng: np.random.Generator, *, spread_ut: float, length_m: float, mean: tuple[float, float, float]
) -> HarmonicField:
    """Gaussian spectrum: ``spread_ut`` is the standard deviation of the vertical component, ``length_m`` its length."""
    wave = rng.standard_normal((_WAVES, 2)) / length_m
    amplitude = spread_ut * np.sqrt(2.0 / _WAVES) * rng.standard_normal(_WAVES)
    return HarmonicField(wave, rng.uniform(0.0, 2.0 * np.pi, _WAVES), amplitude, np.array(mean))


def map_of(
    field: HarmonicField, width_m: float, height_m: float, *, cell_m: float, sd_ut: float, rng: np.random.Generator,
    features: FeatureSet = FeatureSet.VECTOR,
) -> GridMap:  # fmt: skip
    """Map of a rectangle from the origin, with a rim, as a survey with errors of ``sd_ut`` at each node gives it."""
    x = np.arange(-_RIM_M, width_m + _RIM_M + 0.5 * cell_m, cell_m)
    y = np.arange(-_RIM_M, height_m + _RIM_M + 0.5 * cell_m, cell_m)
    xx, yy = np.meshgrid(x, y)
    values = field.at(xx.ravel(), yy.ravel())
    if features is FeatureSet.TOTAL:
        values = np.linalg.norm(values, axis=1)[:, None]
    mean = np.moveaxis((values + sd_ut * rng.standard_normal(values.shape)).reshape(len(y), len(x), -1), -1, 0)
    return GridMap(
        level_id="simulated",
        features=features,
        x0=float(x[0]),
        y0=float(y[0]),
        cell_m=cell_m,
        mean=mean.astype(np.float32),
        sd=np.full(mean.shape, max(sd_ut, 0.01), dtype=np.float32),
        support=np.zeros(xx.shape, dtype=np.float32),
        mapped_m=1.0,
        noise_sd=(0.0,) * mean.shape[0],
    )
