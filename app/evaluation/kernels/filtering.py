"""One step of the particle filter."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import map_coordinates

from app.engine.filtering import Cloud, ParticleNoise, advance_cloud, prepare_grid
from app.engine.types import FeatureSet, Float64Array
from app.evaluation.kernels.fields import CELL_M, random_map
from app.evaluation.kernels.runner import Comparison, Units

PARTICLES = 2000
_WHAT = "step of 2,000 particles, two channels"


def particle_step(rng: np.random.Generator) -> Comparison:
    """Move, compare two channels with a map of mean and variance, weight, resample."""
    grid_map = random_map(rng, FeatureSet.HV, (400, 400))
    grid = prepare_grid(grid_map, FeatureSet.HV)
    cloud = Cloud.empty(PARTICLES)
    cloud.p[0], cloud.p[1] = rng.uniform(90.0, 110.0, (2, PARTICLES))
    cloud.p[12:14] = 10.0
    holder, z = [cloud], np.array([1.0, 0.5, -0.5])

    def ours() -> None:
        noise = ParticleNoise(resample_below=1.0)  # as the peer: each step
        holder[0] = advance_cloud(holder[0], grid, noise, turn_mid=0.01, turn=0.02, stride=0.05, z=z, rng=rng).cloud

    try:
        from filterpy.monte_carlo import systematic_resample
    except ImportError:
        return Comparison(ours, None, Units(_WHAT, note="filterpy is not installed"))
    variance = np.asarray(grid_map.sd[0] ** 2)
    planes = [*grid_map.mean, variance]
    state = [np.column_stack([rng.uniform(90.0, 110.0, (PARTICLES, 2)), np.zeros(PARTICLES), np.ones(PARTICLES)])]

    def peer() -> None:
        p = _moved(state[0], rng)
        at = np.clip([p[:, 1] / CELL_M, p[:, 0] / CELL_M], 0.0, 398.0)
        h, v, spread = (map_coordinates(plane, at, order=1) for plane in planes)
        spread = spread + 1.0
        log = -0.5 * ((z[0] - h) ** 2 + (z[2] - v) ** 2) / spread - np.log(spread)
        w = np.exp(log - log.max())
        state[0] = p[systematic_resample(w / w.sum())]

    return Comparison(ours, peer, Units(_WHAT, "numpy, scipy map_coordinates, filterpy systematic_resample"))


def _moved(p: Float64Array, rng: np.random.Generator) -> Float64Array:
    """Position, heading and stride scale (n, 4), one step on."""
    n = len(p)
    heading = p[:, 2] + 0.02 + 0.1 * rng.standard_normal(n)
    length = 0.05 * p[:, 3] * (1.0 + 0.1 * rng.standard_normal(n))
    return np.column_stack([p[:, 0] + length * np.cos(heading), p[:, 1] + length * np.sin(heading), heading, p[:, 3]])
