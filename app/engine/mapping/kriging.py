"""Block kriging of placed samples onto a grid, with standard deviation."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from app.engine.kernels.kriging import krige_blocks
from app.engine.mapping.model import Covariance, FieldLevel, FieldSamples
from app.engine.types import Float64Array, IntArray, Progress

BLOCK = 4
"""Nodes per block side; a block shares one neighbourhood."""
_CHUNK = 2048


def krige(
    samples: FieldSamples,
    level: FieldLevel,
    covariance: Covariance,
    nodes: Float64Array,
    *,
    neighbours: int = 96,
    block: int = 1,
    progress: Progress | None = None,
) -> tuple[Float64Array, Float64Array]:
    """Simple kriging at ``nodes``; ``block`` successive nodes share the neighbourhood of their centre.

    Chiles and Delfiner, Geostatistics (2012), section 3.2, with a neighbourhood of the nearest samples.

    Parameters
    ----------
    samples : FieldSamples
    level : FieldLevel
    covariance : Covariance
    nodes : array, shape (m, 2), m
        ``m`` a multiple of ``block``.

    Returns
    -------
    mean, sd : arrays, shape (m, channels), uT
    """
    blocks = nodes.shape[0] // block
    centres = nodes.reshape(blocks, block, 2).mean(axis=1)
    k = min(neighbours, len(samples))
    reach = 2.5 * covariance.length_m
    # the neighbourhood of a block is queried with its half diagonal added, so that no node of it is cut short
    half = float(np.abs(nodes[:block] - centres[0]).max()) if block > 1 else 0.0
    _, nb = cKDTree(samples.xy).query(centres, k=k, distance_upper_bound=reach + half)
    nb = nb.reshape(blocks, k)
    count = (nb < len(samples)).sum(axis=1)
    nb = np.where(nb < len(samples), nb, 0)
    z = np.ascontiguousarray((samples.values - level.mean) / level.sd)
    mean = np.empty((nodes.shape[0], z.shape[1]))
    var = np.empty(nodes.shape[0])
    parameters = covariance.kernel_parameters()
    walk = np.ascontiguousarray(samples.walk)
    for a in range(0, blocks, _CHUNK):
        b = min(a + _CHUNK, blocks)
        part = slice(a * block, b * block)
        first = np.arange(0, (b - a) * block + 1, block)
        krige_blocks(samples.xy, walk, z, nb[a:b], count[a:b], nodes[part], first, parameters, mean[part], var[part])
        if progress is not None:
            progress(b / blocks, "kriging")
    return mean * level.sd + level.mean, np.sqrt(var)[:, None] * level.sd


def krige_grid(
    samples: FieldSamples,
    level: FieldLevel,
    covariance: Covariance,
    x: Float64Array,
    y: Float64Array,
    *,
    neighbours: int = 96,
    progress: Progress | None = None,
) -> tuple[Float64Array, Float64Array]:
    """Krige a regular grid; nodes beyond all samples' reach get the level's mean and spread.

    Returns
    -------
    mean, sd : arrays, shape (channels, len(y), len(x)), uT
    """
    rows, columns = len(y), len(x)
    channels = samples.values.shape[1]
    mean = np.broadcast_to(level.mean, (rows, columns, channels)).copy()
    sd = np.broadcast_to(level.sd, (rows, columns, channels)).copy()
    r, c = _block_corners(samples, covariance, x, y)
    if r.shape[0]:
        inner = np.arange(BLOCK)
        rr = (r[:, None, None] + inner[None, :, None] + 0 * inner).reshape(-1)
        cc = (c[:, None, None] + 0 * inner[None, :, None] + inner).reshape(-1)
        step_x, step_y = _spacing(x), _spacing(y)
        nodes = np.stack([x[0] + cc * step_x, y[0] + rr * step_y], axis=1)
        m, s = krige(samples, level, covariance, nodes, neighbours=neighbours, block=BLOCK * BLOCK, progress=progress)
        inside = (rr < rows) & (cc < columns)
        mean[rr[inside], cc[inside]] = m[inside]
        sd[rr[inside], cc[inside]] = s[inside]
    return np.moveaxis(mean, -1, 0), np.moveaxis(sd, -1, 0)


def _spacing(axis: Float64Array) -> float:
    return float(axis[1] - axis[0]) if len(axis) > 1 else 1.0


def _block_corners(
    samples: FieldSamples, covariance: Covariance, x: Float64Array, y: Float64Array
) -> tuple[IntArray, IntArray]:
    """Rows and columns of the blocks that any sample reaches."""
    rows, columns = np.meshgrid(np.arange(0, len(y), BLOCK), np.arange(0, len(x), BLOCK), indexing="ij")
    r, c = rows.ravel(), columns.ravel()
    half = 0.5 * (BLOCK - 1)
    centres = np.stack([x[0] + (c + half) * _spacing(x), y[0] + (r + half) * _spacing(y)], axis=1)
    reach = 2.5 * covariance.length_m + half * np.hypot(_spacing(x), _spacing(y))
    distance, _ = cKDTree(samples.xy).query(centres, distance_upper_bound=reach)
    near = np.isfinite(distance)
    return r[near], c[near]
