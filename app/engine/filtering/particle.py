"""Particle filter on a magnetic map: wrappers about the fused kernel.

Each particle carries position, heading, stride scale and carrying angle; the magnetometer's offset is not sampled but
estimated per particle by a small Kalman filter (Rao-Blackwell; Schon, Gustafsson, Nordlund 2005,
doi:10.1109/TSP.2005.849151). What a walk and a map disagree about is correlated over metres (position errors of the
survey times gradient, height, passing metal); the residual is therefore modelled as a first-order Markov process along
the path and whitened before it is weighted, so that neighbouring steps do not count as independent witnesses. The
whitened residual is Student t, which bounds what one disturbed step can do.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from weakref import WeakKeyDictionary

import numpy as np

from app.engine.errors import MapError
from app.engine.kernels import particle as kernel
from app.engine.types import FeatureSet, Float32Array, Float64Array, GridMap, IntArray

_MODES = {FeatureSet.VECTOR: kernel.VECTOR, FeatureSet.HV: kernel.HV, FeatureSet.TOTAL: kernel.TOTAL}
_DEGREES_OF_FREEDOM = {FeatureSet.VECTOR: 5.0, FeatureSet.HV: 6.0, FeatureSet.TOTAL: 7.0}
_POOL = 1 << 19
OBSTACLE_SD_M = 0.5
OBSTACLE_FLOOR = 0.01


@dataclass(frozen=True, slots=True)
class ParticleNoise:
    """Noise of motion and field, fitted on survey walks (see docs/benchmarks.md).

    Attributes
    ----------
    heading : float, rad per step
    stride : float, share of a stride, per step
    scale_walk : float, change of the stride scale per step
    carry_walk : float, rad, change of the carrying angle per step
    position : float, m per step
    field : float
        Standard deviation of the residual over the map's ``noise_sd``.
    correlation_m : float
        Length over which the noise about the map stays alike.
    map_correlation_m : float
        Length over which the map's own error stays alike.
    offset_walk : float, uT per step
    resample_below : float
        Share of effective particles below which to resample.
    """

    heading: float = 0.013
    stride: float = 0.22
    scale_walk: float = 0.009
    carry_walk: float = 0.004
    position: float = 0.2
    field: float = 3.0
    correlation_m: float = 2.0
    map_correlation_m: float = 5.0
    offset_walk: float = 0.07
    resample_below: float = 0.4


@dataclass(frozen=True, slots=True, eq=False)
class FilterGrid:
    """A map as the kernel reads it: (rows, columns, 7) float32."""

    features: FeatureSet
    x0: float
    y0: float
    cell_m: float
    nodes: Float32Array
    noise_sd: tuple[float, float]
    """Repeatability of the horizontal (or first) channels and of the vertical (or only) one, uT."""

    def lookup(self, x: Float64Array, y: Float64Array) -> Float32Array:
        """Nearest node's values, shape (n, 7)."""
        rows, columns = self.nodes.shape[:2]
        c = np.clip(np.rint((x - self.x0) / self.cell_m).astype(np.int64), 0, columns - 1)
        r = np.clip(np.rint((y - self.y0) / self.cell_m).astype(np.int64), 0, rows - 1)
        return self.nodes[r, c]


_prepared: WeakKeyDictionary[GridMap, dict[FeatureSet, FilterGrid]] = WeakKeyDictionary()


def prepare_grid(grid_map: GridMap, features: FeatureSet) -> FilterGrid:
    """Lay a map out for the kernel; remembered as long as the map lives.

    A vector map also serves ``hv`` and ``total``, an ``hv`` map also serves ``total``.

    Raises
    ------
    MapError
        The map lacks what the feature set needs, or is smaller than two by two nodes.
    """
    known = _prepared.setdefault(grid_map, {})
    if features not in known:
        known[features] = _lay_out(grid_map, features)
    return known[features]


def _lay_out(grid_map: GridMap, features: FeatureSet) -> FilterGrid:
    if min(grid_map.shape) < 2:
        raise MapError("a map needs at least two by two nodes")
    channels = [(m, s.astype(np.float64) ** 2) for m, s in zip(grid_map.mean, grid_map.sd, strict=True)]
    noise = list(grid_map.noise_sd)
    source = grid_map.features
    nodes = np.zeros((*grid_map.shape, 7), dtype=np.float32)
    if features is FeatureSet.VECTOR and source is FeatureSet.VECTOR:
        nodes[..., 0], nodes[..., 1], nodes[..., 2] = (mean for mean, _ in channels)
        nodes[..., 3] = 0.5 * (channels[0][1] + channels[1][1])
        nodes[..., 4] = channels[2][1]
        noises = (float(np.hypot(noise[0], noise[1]) / np.sqrt(2.0)), noise[2])
    elif features is FeatureSet.HV and source in (FeatureSet.VECTOR, FeatureSet.HV):
        vector = source is FeatureSet.VECTOR
        nodes[..., 0] = np.hypot(channels[0][0], channels[1][0]) if vector else channels[0][0]
        nodes[..., 2] = channels[-1][0]
        nodes[..., 3] = 0.5 * (channels[0][1] + channels[1][1]) if vector else channels[0][1]
        nodes[..., 4] = channels[-1][1]
        noises = (noise[0], noise[-1])
    elif features is FeatureSet.TOTAL:
        nodes[..., 2] = np.sqrt(sum(mean.astype(np.float64) ** 2 for mean, _ in channels))
        nodes[..., 4] = sum(var for _, var in channels) / len(channels)
        noises = (noise[0], noise[-1])
    else:
        raise MapError(f"a map of {source.value} features does not serve {features.value}")
    nodes[..., 5] = grid_map.mapped
    nodes[..., 6] = _walkability(grid_map)
    return FilterGrid(features, grid_map.x0, grid_map.y0, grid_map.cell_m, nodes, noises)


def _walkability(grid_map: GridMap) -> Float64Array:
    """Weight of a step that ends at each node: falls with the depth in obstacles, never to nothing.

    Plans are off by some decimetres, doors stand open, and a filter that kills all particles is lost.
    """
    if grid_map.obstacle is None:
        return np.ones(grid_map.shape)
    depth = grid_map.obstacle.astype(np.float64)
    weight: Float64Array = np.maximum(np.exp(-0.5 * (depth / OBSTACLE_SD_M) ** 2), OBSTACLE_FLOOR)
    return weight


@dataclass(frozen=True, slots=True)
class Estimate:
    """Moments of the particles: position (m), covariance (m^2), direction of motion (rad), share on mapped nodes."""

    x: float
    y: float
    cov_xx: float
    cov_xy: float
    cov_yy: float
    heading: float
    mapped: float
    likelihood: float = 1.0
    """Of the step's reading, over what is constant for all particles: what was left of the weights."""


@dataclass(slots=True)
class Cloud:
    """Particles: (15, n) float32, rows as in :mod:`app.engine.kernels.particle`; ``moved`` once a step was taken."""

    p: Float32Array
    moved: bool = False

    @property
    def n(self) -> int:
        """Number of particles."""
        return int(self.p.shape[1])

    @classmethod
    def empty(cls, n: int) -> Cloud:
        """Particles at the origin with equal weights."""
        p = np.zeros((kernel.ROWS, n), dtype=np.float32)
        p[2] = 1.0
        p[4] = 1.0
        p[14] = 1.0 / n
        return cls(p)

    def thin(self, n: int, u: float) -> Cloud:
        """Systematically resampled to ``n`` particles; ``u`` in [0, 1)."""
        return self.take(self.draw(n, u))

    def draw(self, n: int, u: float) -> IntArray:
        """Indices of ``n`` particles drawn systematically by weight; ``u`` in [0, 1)."""
        positions = (np.arange(n) + u) / n
        index = np.searchsorted(np.cumsum(self.p[14], dtype=np.float64), positions)
        return np.minimum(index, self.n - 1)

    def take(self, index: IntArray) -> Cloud:
        """These particles, with equal weights."""
        p = np.ascontiguousarray(self.p[:, index])
        p[14] = 1.0 / len(index)
        return Cloud(p, self.moved)


@dataclass(frozen=True, slots=True)
class Advance:
    """What a step gave.

    Attributes
    ----------
    cloud : Cloud
        After the step, resampled if need be.
    weighted : Cloud
        Before resampling: the particles the estimate was taken from.
    ancestors : array, shape (n,), or None
        Where each particle of ``cloud`` stood in ``weighted``; None if it was not resampled.
    estimate : Estimate
    """

    cloud: Cloud
    weighted: Cloud
    ancestors: IntArray | None
    estimate: Estimate


@lru_cache(maxsize=1)
def normal_pool() -> Float32Array:
    """Standard normals that all filters of a process share, read from a random place at each step.

    Drawing them anew would cost more than the rest of the step; half a million values repeat too seldom to matter.
    """
    return np.random.default_rng(20221122).standard_normal(_POOL, dtype=np.float32)


def advance_cloud(
    cloud: Cloud,
    grid: FilterGrid,
    noise: ParticleNoise,
    *,
    turn_mid: float,
    turn: float,
    stride: float,
    z: Float64Array,
    rng: np.random.Generator,
) -> Advance:
    """One step of the walker.

    Parameters
    ----------
    cloud : Cloud
        Consumed: its arrays are overwritten.
    turn_mid, turn : float, rad
        Turn of the device since the last step, to the middle and to the end of this one.
    stride : float, m
    z : array, shape (3,), uT
        Channels as the kernel wants them for the grid's features.

    """
    # one memory layout, one compiled kernel: with others about, rounding would depend on what a process did before
    z = np.ascontiguousarray(z, np.float64)
    parameters = np.array(
        [
            1.0 / grid.cell_m, noise.heading, noise.stride, noise.scale_walk, noise.carry_walk, noise.position,
            (noise.field * grid.noise_sd[0]) ** 2, (noise.field * grid.noise_sd[1]) ** 2,
            1.0 / noise.correlation_m, _DEGREES_OF_FREEDOM[grid.features], noise.resample_below,
            noise.offset_walk**2,
            1.0 / noise.map_correlation_m,
        ]
    )  # fmt: skip
    motion = np.array([turn_mid, turn, stride, grid.x0, grid.y0])
    pool = normal_pool()
    offset = int(rng.integers(_POOL - 4 * cloud.n))
    scratch = np.empty_like(cloud.p)
    moments = np.empty(10)
    ancestors = np.empty(cloud.n, dtype=np.int64)
    resampled = kernel.step(
        cloud.p, scratch, grid.nodes, motion, z, parameters, _MODES[grid.features], not cloud.moved,
        pool, offset, float(rng.random()), moments, ancestors,
    )  # fmt: skip
    weighted = Cloud(cloud.p, moved=True)
    return Advance(
        cloud=Cloud(scratch, moved=True) if resampled else weighted,
        weighted=weighted,
        ancestors=ancestors if resampled else None,
        estimate=_estimate(moments),
    )


def _estimate(moments: Float64Array) -> Estimate:
    return Estimate(
        x=float(moments[1]),
        y=float(moments[2]),
        cov_xx=float(moments[3]),
        cov_xy=float(moments[4]),
        cov_yy=float(moments[5]),
        heading=float(np.arctan2(moments[7], moments[6])),
        mapped=float(moments[8]),
        likelihood=float(moments[0]),
    )
