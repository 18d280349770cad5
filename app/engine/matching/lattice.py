"""A criterion at all shifts of a track by whole nodes of a map, or of a coarser one made of it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numba import config

from app.engine.kernels import contour, lanes_contour
from app.engine.matching.criteria import Criterion, Moments, as_cost, centred, evaluate, evaluate_moments
from app.engine.types import BoolArray, Float32Array, Float64Array, IntArray

_DIFFERENCE = (Criterion.MAD, Criterion.AD, Criterion.MSD, Criterion.SD)
_ABSOLUTE = (Criterion.MAD, Criterion.AD)
_CHUNK = 2_000_000
"""Readings that the plain way holds at once."""


@dataclass(frozen=True, slots=True)
class LatticePoints:
    """Tracks on a lattice at the first shift.

    Attributes
    ----------
    i, j : array, shape (..., n)
        Row and column of the node below each point.
    v, u : array, shape (..., n)
        Fraction of a node's distance beyond it, towards the next row and column.
    z : array, shape (..., channels, n), uT
        Readings less the map's reference.
    """

    i: IntArray
    j: IntArray
    v: Float32Array
    u: Float32Array
    z: Float32Array

    def __getitem__(self, k: int) -> LatticePoints:
        """One of several tracks."""
        return LatticePoints(self.i[k], self.j[k], self.v[k], self.u[k], self.z[k])

    def moved(self, rows: int) -> LatticePoints:
        """The same, so many rows of nodes on."""
        return replace(self, i=self.i + rows) if rows else self


@dataclass(frozen=True, slots=True, eq=False)
class LatticeMap:
    """Part of a map, padded with unmapped ground, on nodes ``pitch`` cells apart.

    Attributes
    ----------
    planes : array, shape (channels, rows, columns), float32, uT
        Means over ``pitch x pitch`` mapped cells, less ``reference``.
    weight : array, shape (rows, columns), float32
        Share of these cells that is mapped.
    reference : array, shape (channels,), uT
        What is taken off map and readings alike, so that float32 sums keep their digits.
    row0, column0 : float, cells
        Where node [0, 0] lies on the map.
    pitch : int, cells
    whole : bool
        All of it is mapped.
    """

    planes: Float32Array
    weight: Float32Array
    reference: Float64Array
    row0: float
    column0: float
    pitch: int
    whole: bool

    @classmethod
    def of(
        cls,
        planes: Float32Array,
        mapped: BoolArray,
        *,
        pitch: int,
        reference: Float64Array,
        low: tuple[float, float],
        high: tuple[float, float],
    ) -> LatticeMap:
        """The part of a map from ``low`` to ``high`` (row, column; cells, may lie beyond its edges)."""
        first = [int(np.floor(one)) - pitch for one in low]
        used = [int(np.ceil((b - a) / pitch)) + 2 for a, b in zip(first, high, strict=True)]
        counts = [k + more for k, more in zip(used, (lanes_contour.ROWS, lanes_contour.LANES), strict=True)]
        rows, columns = (a + np.arange(pitch * k) for a, k in zip(first, counts, strict=True))
        inside = ((rows >= 0) & (rows < mapped.shape[0]))[:, None] & ((columns >= 0) & (columns < mapped.shape[1]))
        near = np.ix_(np.clip(rows, 0, mapped.shape[0] - 1), np.clip(columns, 0, mapped.shape[1] - 1))
        weight = (mapped[near] & inside).astype(np.float32)
        part = np.stack([plane[near] for plane in planes]) - reference.astype(np.float32)[:, None, None]
        if pitch > 1:
            part, weight = _block_means(part, weight, pitch)
        middle, whole = 0.5 * (pitch - 1), bool(weight[: used[0], : used[1]].min() == 1.0)
        return cls(
            np.ascontiguousarray(part),
            weight,
            reference,
            first[0] + middle,
            first[1] + middle,
            pitch,
            whole,
        )

    def points(self, row: Float64Array, column: Float64Array, values: Float64Array) -> LatticePoints:
        """Tracks at the first shift: ``row``, ``column`` (..., n), cells; ``values`` (..., n, channels), uT."""
        y, x = (row - self.row0) / self.pitch, (column - self.column0) / self.pitch
        i, j = np.floor(y).astype(np.int64), np.floor(x).astype(np.int64)
        z = np.ascontiguousarray(np.swapaxes(values - self.reference, -1, -2), dtype=np.float32)
        return LatticePoints(i, j, (y - i).astype(np.float32), (x - j).astype(np.float32), z)

    def costs(
        self, points: LatticePoints, shape: tuple[int, int], criterion: Criterion, *, centre: bool, mapped: float
    ) -> Float32Array:
        """Cost at ``shape`` shifts by rows and columns of nodes; infinite where less than ``mapped`` is on the map."""
        n = len(points.i)
        tiles = (_up(shape[0], lanes_contour.ROWS), _up(shape[1], lanes_contour.LANES))
        weight = np.full(tiles, float(n), dtype=np.float32)
        if not self.whole:
            weight[:] = 0.0
            contour.lattice_weight(self.weight, points.i, points.j, points.v, points.u, weight)
        if criterion in _ABSOLUTE or (criterion in _DIFFERENCE and not centre):
            cost = self._difference(points, weight, criterion, centre)
        elif criterion is Criterion.HAUSDORFF:
            cost = self._plainly(points, tiles, criterion, centre)
        else:
            moments = self._moments(points, weight).shifted(self.reference)
            value = evaluate_moments(criterion, moments.centred() if centre else moments, n)
            cost = as_cost(criterion, value).astype(np.float32)
        if not self.whole:
            cost[(weight < mapped * n) | (weight <= 0.0)] = np.inf
        return cost[: shape[0], : shape[1]]

    def _difference(
        self, points: LatticePoints, weight: Float32Array, criterion: Criterion, centre: bool
    ) -> Float32Array:
        squared, total = criterion not in _ABSOLUTE, np.zeros(weight.shape, dtype=np.float32)
        offset = self._moments(points, weight).offset().astype(np.float32) if centre else None
        for c, plane in enumerate(self.planes):
            self._add_difference(plane, None if offset is None else offset[c], points, points.z[c], squared, total)
        channels, n = points.z.shape
        factor = float(n) if criterion in (Criterion.AD, Criterion.SD) else 1.0 / channels
        total *= np.float32(factor / n) if self.whole else np.float32(factor) / np.maximum(weight, np.float32(1e-30))
        return total

    def _add_difference(
        self,
        plane: Float32Array,
        offset: Float32Array | None,
        points: LatticePoints,
        z: Float32Array,
        squared: bool,
        total: Float32Array,
    ) -> None:
        i, j, v, u = points.i, points.j, points.v, points.u
        if config.DISABLE_JIT:  # lanes exist only compiled
            none = np.zeros_like(total)
            contour.lattice_difference(
                plane, self.weight, none if offset is None else offset, i, j, v, u, z, squared, total
            )
            return
        stride = plane.shape[1]
        below, near = i * stride + j, (i + (v > 0.5)) * stride + j + (u > 0.5)
        weight = None if self.whole else self.weight
        lanes_contour.lattice_difference(plane, weight, offset, below, near, v, u, z, squared, total)

    def _moments(self, points: LatticePoints, weight: Float32Array) -> Moments:
        total = np.zeros((points.z.shape[0], 5, *weight.shape), dtype=np.float32)
        for c, plane in enumerate(self.planes):
            contour.lattice_moments(plane, self.weight, points.i, points.j, points.v, points.u, points.z[c], total[c])
        s, ss, sz, z, zz = np.moveaxis(total.astype(np.float64), 1, 0)
        return Moments(weight.astype(np.float64), s, ss, sz, z, zz)

    def _plainly(
        self, points: LatticePoints, shape: tuple[int, int], criterion: Criterion, centre: bool
    ) -> Float32Array:
        """By the criterion's formula, some rows of shifts at a time."""
        channels, n = points.z.shape
        measured = points.z.T.astype(np.float64) + self.reference
        out = np.empty(shape, dtype=np.float32)
        step = max(1, _CHUNK // (shape[1] * n * max(channels, n)))
        for y in range(0, shape[0], step):
            rows = min(step, shape[0] - y)
            readings = np.empty((rows, shape[1], n, channels))
            weight = np.empty((rows, shape[1], n))
            for k in range(n):
                a, b, v, u = points.i[k] + y, points.j[k], float(points.v[k]), float(points.u[k])
                part = self.planes[:, a : a + rows + 1, b : b + shape[1] + 1].astype(np.float64)
                low = part[:, :, :-1] + u * (part[:, :, 1:] - part[:, :, :-1])
                reading = low[:, :-1] + v * (low[:, 1:] - low[:, :-1])
                readings[:, :, k] = np.moveaxis(reading, 0, -1) + self.reference
                near, beside = a + (v > 0.5), b + (u > 0.5)
                weight[:, :, k] = self.weight[near : near + rows, beside : beside + shape[1]]
            compared = centred(measured, readings, weight) if centre else measured
            out[y : y + rows] = as_cost(criterion, evaluate(criterion, compared, readings, weight))
        return out


def _block_means(part: Float32Array, weight: Float32Array, pitch: int) -> tuple[Float32Array, Float32Array]:
    """Means over blocks of cells, of the mapped ones where there are any, and the share that is mapped."""
    share = _mean(weight, pitch)
    if share.min() == 1.0:
        return _mean(part, pitch), share
    known = _mean(part * weight, pitch) / np.maximum(share, np.float32(1e-6))
    return np.where(share > 0.0, known, _mean(part, pitch)), share


def _mean(plane: Float32Array, pitch: int) -> Float32Array:
    """Over blocks of the last two axes."""
    total = plane[..., ::pitch, ::pitch].copy()
    for a, b in np.ndindex(pitch, pitch):
        if a or b:
            total += plane[..., a::pitch, b::pitch]
    return np.asarray(total / np.float32(pitch**2))


def _up(count: int, tile: int) -> int:
    """The next whole number of tiles."""
    return -(-count // tile) * tile
