"""Random fields for timing."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter

from app.engine.types import FeatureSet, Float32Array, GridMap

CELL_M = 0.5


def random_map(rng: np.random.Generator, features: FeatureSet, shape: tuple[int, int]) -> GridMap:
    """A smooth field of 8 uT and 2 m on cells of 0.5 m, everywhere mapped."""
    planes = np.stack([_smooth(rng, shape) for _ in features.channels])
    return GridMap(
        level_id="random",
        features=features,
        x0=0.0,
        y0=0.0,
        cell_m=CELL_M,
        mean=planes,
        sd=np.full(planes.shape, 0.5, dtype=np.float32),
        support=np.zeros(shape, dtype=np.float32),
        mapped_m=1.5,
        noise_sd=(1.0,) * len(planes),
    )


def _smooth(rng: np.random.Generator, shape: tuple[int, int]) -> Float32Array:
    field = gaussian_filter(rng.standard_normal(shape), 2.0 / CELL_M / np.sqrt(2.0), mode="wrap")
    return np.asarray(8.0 * field / field.std(), dtype=np.float32)
