"""Search of a walk on a level, nothing known but the level."""

from __future__ import annotations

import numpy as np

from app.engine.filtering import prepare_grid
from app.engine.inertial import StepEvents
from app.engine.localization.initial import InitialSpread
from app.engine.localization.particle import ParticleParameters
from app.engine.localization.search import Found, SearchPolicy, search
from app.engine.matching import read_map
from app.engine.types import FeatureSet, GridMap, Prior
from app.evaluation.kernels.fields import random_map
from app.evaluation.kernels.runner import Comparison, Units

_STEPS, _STRIDE_M, _INTERVAL_S = 60, 0.7, 0.5


def cold_start(rng: np.random.Generator) -> Comparison:
    """A walk of 60 steps on a level of 100 m x 60 m; no peer: nobody offers this."""
    grid_map = random_map(rng, FeatureSet.VECTOR, (120, 200))
    grids, events = {"random": prepare_grid(grid_map, FeatureSet.VECTOR)}, _steps(grid_map, rng)

    def ours() -> Found:
        return search(
            events,
            grids,
            Prior("random"),
            particles=ParticleParameters().cold_particles,
            report=15,
            spread=InitialSpread(),
            policy=SearchPolicy(),
            rng=np.random.default_rng(3),
        )

    return Comparison(ours, None, Units("search of 60 steps on a level of 100 m x 60 m", note="no peer offers this"))


def _steps(grid_map: GridMap, rng: np.random.Generator) -> StepEvents:
    """Steps along a bend and what a levelled device reads at each."""
    n = _STEPS
    heading = np.where(np.arange(n) < n // 2, 0.0, 0.5 * np.pi) + 0.02 * rng.standard_normal(n)
    x = 15.0 + np.cumsum(_STRIDE_M * np.cos(heading))
    y = 15.0 + np.cumsum(_STRIDE_M * np.sin(heading))
    east, north, up = read_map(grid_map, FeatureSet.VECTOR, x, y).mean.T
    c, s = np.cos(heading), np.sin(heading)
    mag = np.column_stack([c * east + s * north, c * north - s * east, up]) + rng.standard_normal((n, 3))
    none = np.zeros(n, dtype=bool)
    return StepEvents(
        t=_INTERVAL_S * np.arange(1.0, n + 1.0),
        swing=np.full(n, 4.0),
        motion_heading=heading,
        heading=heading,
        mag=mag,
        stride=np.full(n, _STRIDE_M),
        measured=none,
        disturbed=none,
        shift=np.zeros(n),
        carrying=none,
    )
