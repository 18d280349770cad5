"""A map from survey samples."""

from __future__ import annotations

import numpy as np

from app.engine.mapping import Covariance, FieldLevel, FieldSamples, krige_grid
from app.engine.types import Float64Array
from app.evaluation.kernels.runner import Comparison, Units

SAMPLES, NODES = 20_000, 400
_PEER_SAMPLES, _PEER_NODES, _WINDOW = 1_000, 400, 16
_WHAT = "map, 20,000 samples onto 400 x 400 nodes, one channel with deviation"


def map_build(rng: np.random.Generator) -> Comparison:
    """Kriging of lines 2 m apart over 100 m x 100 m."""
    along = rng.uniform(0.0, 100.0, SAMPLES)
    xy = np.column_stack([along, 2.0 * rng.integers(0, 50, SAMPLES) + 0.1 * rng.standard_normal(SAMPLES)])
    samples = FieldSamples(xy, rng.integers(0, 80, SAMPLES), rng.standard_normal((SAMPLES, 1)))
    level, axis = FieldLevel(np.zeros(1), np.ones(1)), 0.25 * np.arange(float(NODES))

    def ours() -> tuple[Float64Array, Float64Array]:
        return krige_grid(samples, level, Covariance(), axis, axis)

    try:
        from pykrige.ok import OrdinaryKriging
    except ImportError:
        return Comparison(ours, None, Units(_WHAT, note="pykrige is not installed"))
    some = rng.choice(SAMPLES, _PEER_SAMPLES, replace=False)
    variogram = {"sill": 1.0, "range": 6.0, "nugget": 0.1}
    kriging = OrdinaryKriging(
        xy[some, 0], xy[some, 1], samples.values[some, 0], variogram_model="exponential", variogram_parameters=variogram
    )
    x, y = rng.uniform(5.0, 95.0, (2, _PEER_NODES))

    def peer() -> object:
        return kriging.execute("points", x, y, n_closest_points=_WINDOW, backend="loop")

    share = _PEER_NODES / NODES**2
    name = f"pykrige moving window of {_WINDOW} (scaled from {_PEER_NODES} of {NODES**2:,} nodes, variogram given)"
    return Comparison(ours, peer, Units(_WHAT, name, theirs=share))
