"""Block kriging of placed samples onto a grid, with standard deviation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from app.engine.kernels.kriging import krige_blocks, krige_gradient_blocks
from app.engine.kernels.neighbours import spread_out
from app.engine.mapping.model import Covariance, FieldLevel, FieldSamples
from app.engine.types import BoolArray, Float64Array, IntArray, Progress

NEIGHBOURS = 88
"""Samples that a block is kriged from."""
_CANDIDATES = 3
"""Times as many nearest samples they are chosen among."""
_SPACING_LENGTHS = 0.5
"""Samples of one walk are taken this far apart, in lengths of the walk's error, where it is much of what they say:"""
_MUCH_ERROR = 0.1
"""from this variance on, in sills."""
_BLOCK_LENGTHS = 1.4
"""Side of a block in lengths of the field's fine part: a neighbourhood serves the whole block."""
LARGEST_BLOCK = 8
"""Nodes per block side."""
_CHUNK = 256
"""Blocks between two calls of the progress function, about a tenth of a second."""
_SINGLE_PRECISION_NOISE = 1e-3
"""With less noise than this, in sills, the factorization needs double precision."""


def krige(
    samples: FieldSamples,
    level: FieldLevel,
    covariance: Covariance,
    nodes: Float64Array,
    *,
    neighbours: int = NEIGHBOURS,
    progress: Progress | None = None,
) -> tuple[Float64Array, Float64Array]:
    """Simple kriging at ``nodes``, each with a neighbourhood of its own.

    Chiles and Delfiner, Geostatistics (2012), section 3.2, with a neighbourhood of the nearest samples.

    Parameters
    ----------
    samples : FieldSamples
    level : FieldLevel
    covariance : Covariance
    nodes : array, shape (m, 2), m

    Returns
    -------
    mean, sd : arrays, shape (m, channels), uT
    """
    each = _Blocks(np.arange(len(nodes) + 1), nodes, 0.0)
    return _krige(samples, level, covariance, nodes, each, neighbours, progress)


def krige_grid(
    samples: FieldSamples,
    level: FieldLevel,
    covariance: Covariance,
    x: Float64Array,
    y: Float64Array,
    *,
    neighbours: int = NEIGHBOURS,
    progress: Progress | None = None,
) -> tuple[Float64Array, Float64Array]:
    """Krige a regular grid; nodes beyond all samples' reach get the level's mean and spread.

    Returns
    -------
    mean, sd : arrays, shape (channels, len(y), len(x)), uT
    """
    everywhere = np.ones((len(y), len(x)), dtype=bool)
    mean, sd = krige_nodes(samples, level, covariance, x, y, everywhere, neighbours=neighbours, progress=progress)
    return mean.reshape(-1, len(y), len(x)), sd.reshape(-1, len(y), len(x))


def krige_nodes(
    samples: FieldSamples,
    level: FieldLevel,
    covariance: Covariance,
    x: Float64Array,
    y: Float64Array,
    where: BoolArray,
    *,
    neighbours: int = NEIGHBOURS,
    progress: Progress | None = None,
) -> tuple[Float64Array, Float64Array]:
    """Krige some nodes of a regular grid, as :func:`krige_grid` would.

    Blocks lie on one lattice, whatever the grid's corner: a node gets the same value whether the whole grid is kriged,
    some of it, or a larger one. What ``progress`` raises ends the work, and nothing has changed.

    Parameters
    ----------
    x, y : arrays, m
        Evenly spaced coordinates of columns and rows, multiples of the spacing.
    where : array of bool, shape (len(y), len(x))

    Returns
    -------
    mean, sd : arrays, shape (channels, m), uT
        In row-major order of the ``m`` nodes where ``where`` holds.
    """
    row, column = np.nonzero(where)
    nodes = np.stack([x[column], y[row]], axis=1)
    mean = np.broadcast_to(level.mean, (len(nodes), len(level.mean))).copy()
    sd = np.broadcast_to(level.sd, mean.shape).copy()
    order, blocks = _blocks(x, y, row, column, covariance)
    if len(samples) and len(order):
        distance, _ = cKDTree(samples.xy).query(blocks.centre)
        near = np.asarray(distance <= covariance.reach_m + blocks.half)
        order, blocks = order[np.repeat(near, np.diff(blocks.first))], blocks.subset(near)
        mean[order], sd[order] = _krige(samples, level, covariance, nodes[order], blocks, neighbours, progress)
    return mean.T, sd.T


@dataclass(frozen=True, slots=True)
class _Blocks:
    """Successive nodes that share a neighbourhood.

    ``first`` (blocks + 1,) is where each begins, ``centre`` (blocks, 2) the middle of the whole block, asked for or
    not, and ``half`` its half diagonal, m.
    """

    first: IntArray
    centre: Float64Array
    half: float

    def __len__(self) -> int:
        return len(self.centre)

    def subset(self, keep: BoolArray) -> _Blocks:
        first = np.concatenate([[0], np.cumsum(np.diff(self.first)[keep])])
        return _Blocks(first, self.centre[keep], self.half)

    def part(self, a: int, b: int) -> tuple[slice, _Blocks]:
        """Blocks ``a`` to ``b``, and the rows of their nodes."""
        first = self.first[a : b + 1]
        return slice(int(first[0]), int(first[-1])), _Blocks(first - first[0], self.centre[a:b], self.half)


def _blocks(
    x: Float64Array, y: Float64Array, row: IntArray, column: IntArray, covariance: Covariance
) -> tuple[IntArray, _Blocks]:
    """Order of nodes by block, and the blocks."""
    step_x, step_y = _spacing(x), _spacing(y)
    length = covariance.fine_length_m if covariance.fine > 0 else covariance.length_m
    nodes = np.clip(_BLOCK_LENGTHS * length / max(step_x, step_y), 1, LARGEST_BLOCK)
    side = 2 ** int(np.log2(nodes))
    # counted from the origin: all grids of a level share their lattice
    first_row, first_column = round(float(y[0]) / step_y), round(float(x[0]) / step_x)
    r, c = (row + first_row) // side, (column + first_column) // side
    order = np.lexsort((column, row, c, r))
    block = np.stack([c, r], axis=1)[order]
    new = np.ones(len(order), dtype=bool)
    new[1:] = (np.diff(block, axis=0) != 0).any(axis=1)
    corner = side * block[new] - [first_column, first_row]
    centre = np.array([x[0], y[0]]) + (corner + 0.5 * (side - 1)) * [step_x, step_y]
    return order, _Blocks(
        np.append(np.flatnonzero(new), len(order)), centre, 0.5 * (side - 1) * float(np.hypot(step_x, step_y))
    )


def _spacing(axis: Float64Array) -> float:
    return float(axis[1] - axis[0]) if len(axis) > 1 else 1.0


def _krige(
    samples: FieldSamples,
    level: FieldLevel,
    covariance: Covariance,
    nodes: Float64Array,
    blocks: _Blocks,
    neighbours: int,
    progress: Progress | None,
) -> tuple[Float64Array, Float64Array]:
    """Mean and standard deviation (m, channels) of nodes in blocks."""
    unit, channels = level.sd.copy(), len(level.sd)
    parts = [slice(0, channels)]
    if covariance.curl_free and channels >= 2:
        unit[:2] /= np.sqrt(covariance.gradient_sills)
        parts = [slice(0, 2), slice(2, channels)] if channels > 2 else [slice(0, 2)]
    mean, var = np.zeros((len(nodes), channels)), np.ones((len(nodes), channels))
    if not len(nodes) or not len(samples):
        return mean + level.mean, var * level.sd
    job = _Job.of(samples, (samples.values - level.mean) / unit, covariance)
    for a in range(0, len(blocks), _CHUNK):
        rows, some = blocks.part(a, min(a + _CHUNK, len(blocks)))
        asked = nodes[rows] @ job.shape
        index, count = job.neighbours(some, neighbours)
        for part in parts:
            joint = covariance.curl_free and part.start == 0
            mean[rows, part], var[rows, part] = job.solve(part, asked, some.first, index, count, joint=joint)
        if progress is not None:
            progress(min(a + _CHUNK, len(blocks)) / len(blocks), "kriging")
    return mean * unit + level.mean, np.sqrt(var) * unit


@dataclass(frozen=True, slots=True)
class _Job:
    """Samples in the isotropic plane, in the type of the arithmetic."""

    shape: Float64Array
    xy: Float64Array
    tree: cKDTree
    walk: IntArray
    z: Float64Array
    error: Float64Array
    white: Float64Array
    parameters: Float64Array
    reach: float
    spacing: float

    @classmethod
    def of(cls, samples: FieldSamples, z: Float64Array, covariance: Covariance) -> _Job:
        error, white = samples.noise(covariance)
        least = float((error**2 + white).min())
        kind = np.float32 if least >= _SINGLE_PRECISION_NOISE else np.float64
        shape = covariance.to_isotropic()
        xy = samples.xy @ shape
        return cls(
            shape=shape,
            xy=xy,
            tree=cKDTree(xy),
            walk=np.ascontiguousarray(samples.walk),
            z=z.astype(kind),
            error=error.astype(kind),
            white=white.astype(kind),
            parameters=covariance.kernel_parameters().astype(kind),
            reach=2.5 * covariance.length_m,
            spacing=_SPACING_LENGTHS * covariance.error_length_m if covariance.error >= _MUCH_ERROR else 0.0,
        )

    def neighbours(self, blocks: _Blocks, wanted: int) -> tuple[IntArray, IntArray]:
        """Indices (blocks, k) of the samples to krige each block from, and how many they are."""
        k = min(_CANDIDATES * wanted, len(self.xy))
        # asked with half a block's diagonal added, so that no node of it is cut short
        _, near = self.tree.query(blocks.centre @ self.shape, k=k, distance_upper_bound=self.reach + blocks.half)
        near = near.reshape(len(blocks), k)
        found = (near < len(self.xy)).sum(axis=1)
        chosen, count = np.zeros((len(blocks), min(wanted, k)), np.int64), np.empty(len(blocks), np.int64)
        spread_out(self.xy, self.walk, near, found, self.spacing, chosen, count)
        return chosen, count

    def solve(
        self, part: slice, nodes: Float64Array, first: IntArray, index: IntArray, count: IntArray, *, joint: bool
    ) -> tuple[Float64Array, Float64Array]:
        z = np.ascontiguousarray(self.z[:, part])
        mean = np.empty((len(nodes), z.shape[1]))
        var = np.empty((len(nodes), 2 if joint else 1))
        kernel = krige_gradient_blocks if joint else krige_blocks
        kernel(self.xy, self.walk, z, self.error, self.white, index, count, nodes, first, self.parameters, mean, var)
        return mean, var
