"""How well a walker will be located: the posterior Cramer-Rao bound of a map, before anybody walks.

The bound of Tichavsky, Muravchik and Nehorai (1998, doi:10.1109/78.668800) for a walker whose dead reckoning drifts and
whose readings err by more than white noise: no unbiased method that knows the same can do better, and one that works
comes near. With Gaussian errors and the field linear over the walker's uncertainty it is the covariance recursion of a
Kalman filter on the state (x, y, heading error, sensor offsets, error that neighbouring readings share). The shared
error keeps a second reading half a metre on from counting as an independent witness.

What a map does not know is charged as an error of the reading (``sd`` in every node, shared between neighbours like the
rest). Slopes are taken from the mean as it is: a kriged mean is smoother than the field, so noise does not feign
slopes where nobody walked; there the mean is flat and the bound is that of dead reckoning. What the bound
cannot see is a wrong place altogether: see :mod:`app.engine.mapping.similarity`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from app.engine.errors import InputError, MapError
from app.engine.kernels import forecast as kernel
from app.engine.types import BoolArray, FeatureSet, Float32Array, Float64Array, GridMap, IntArray

HEADINGS_DEG = (0, 45, 90, 135, 180, 225, 270, 315)
"""Directions of travel of a raster, counter-clockwise from +x: those in which nodes follow one another."""
_MOVES = ((0, 1), (1, 1), (1, 0), (1, -1), (0, -1), (-1, -1), (-1, 0), (-1, 1))
APPROACH_M = 10.0
"""A heading counts in full at nodes to which it leads this far over walkable ground: nobody comes out of a wall."""
WALKABLE_DEPTH_M = 0.5
"""Plans are off by some decimetres: nodes less deep in a wall count as walkable."""
MAX_NODES = 500_000
"""Of a raster, for time and memory: a larger part of a map is thinned."""
ROUTE_STEP_M = 0.5
LOST_M = 5.0
"""A forecast error above this is no position that somebody could use indoors."""


@dataclass(frozen=True, slots=True)
class WalkerErrors:
    """What a located walker errs by, per metre of way; the defaults are a phone held in the hand.

    Attributes
    ----------
    position_m : float, m
        Standard deviation of the position per axis at the start.
    heading : float, rad
        Of the heading at the start: how the phone is held against the way.
    along, across : float, m per square root of a metre
        Growth of dead reckoning's error: stride lengths, and sway.
    heading_walk : float, rad per square root of a metre
    offset : float, uT
        Of the magnetometer's offset, as a session knows it after half a minute (at the start of a first one: 5.5).
    offset_walk : float, uT per square root of a metre
    shared : float
        Share of the map's ``noise_sd`` (its variance) that neighbouring readings have in common.
    shared_m : float, m
        Over which length.
    reading_m : float, m
        Way from one reading to the next, two a step, for the rest of that variance.

    Notes
    -----
    ``along``, ``across``, ``heading`` and the walks are those of the particle tracker, fitted on survey walks, at
    0.7 m a step; ``shared`` and ``shared_m`` those of the map's covariance (walk error 0.4 against 0.1 white, 2 m).
    """

    position_m: float = 3.0
    heading: float = 0.11
    along: float = 0.30
    across: float = 0.24
    heading_walk: float = 0.016
    offset: float = 1.5
    offset_walk: float = 0.084
    shared: float = 0.8
    shared_m: float = 2.0
    reading_m: float = 0.35

    def kernel_parameters(self) -> Float64Array:
        """Parameters as the kernel wants them."""
        return np.array(
            [
                self.along**2, self.across**2, self.heading_walk**2, self.offset_walk**2, 1.0 / self.shared_m,
                self.reading_m, self.position_m**2, self.heading**2, self.offset**2,
            ]
        )  # fmt: skip


PHONE = WalkerErrors()
"""A phone held in the hand."""


@dataclass(frozen=True, slots=True, eq=False)
class AccuracyForecast:
    """Expected accuracy per node and heading.

    Node ``[r, c]`` lies at ``(x0 + c * cell_m, y0 + r * cell_m)``: the part of the map's grid that holds mapped nodes,
    coarser where that is large.

    Attributes
    ----------
    x0, y0, cell_m : float, m
    covariance : array, shape (8, rows, columns, 3), float32, m^2
        xx, xy, yy of the position for the directions of :data:`HEADINGS_DEG`; NaN where not mapped or not walkable.
    approach : array, shape (8, rows, columns), float32, m
        How far the walker has come in this direction over walkable ground.
    """

    x0: float
    y0: float
    cell_m: float
    covariance: Float32Array
    approach: Float32Array

    def error(self, heading: int) -> Float32Array:
        """Expected horizontal error (root mean square distance, m) for one heading, shape (rows, columns)."""
        error: Float32Array = np.sqrt(self.covariance[heading, ..., 0] + self.covariance[heading, ..., 2])
        return error

    def along(self, heading: int) -> Float32Array:
        """Standard deviation along the way, m."""
        return self._in_direction(heading, math.radians(HEADINGS_DEG[heading]))

    def across(self, heading: int) -> Float32Array:
        """Standard deviation across the way, m."""
        return self._in_direction(heading, math.radians(HEADINGS_DEG[heading] + 90.0))

    def _in_direction(self, heading: int, angle: float) -> Float32Array:
        c, s = np.float32(math.cos(angle)), np.float32(math.sin(angle))
        xx, xy, yy = (self.covariance[heading, ..., k] for k in range(3))
        sd: Float32Array = np.sqrt(np.maximum(c * c * xx + 2 * c * s * xy + s * s * yy, np.float32(0.0)))
        return sd

    def weights(self) -> Float32Array:
        """How much each heading counts at a node, shape (8, rows, columns).

        By its approach, up to 10 m; a heading with less than half the approach of the best one does not count at all.
        """
        weight: Float32Array = np.minimum(self.approach / np.float32(APPROACH_M), np.float32(1.0))
        # a lone node has no approach at all: there all headings count alike
        weight = np.where(weight.max(axis=0) > 0.0, weight, np.float32(1.0))
        return np.where(weight >= 0.5 * weight.max(axis=0), weight, np.float32(0.0))

    def mean_error(self) -> Float32Array:
        """Root mean square of the errors over the headings that count, m, shape (rows, columns)."""
        weight = self.weights()
        mean: Float32Array = np.sqrt((weight * self._trace()).sum(axis=0) / weight.sum(axis=0))
        return mean

    def worst_error(self) -> Float32Array:
        """Largest error over the headings that count, m, shape (rows, columns)."""
        worst: Float32Array = np.sqrt(np.where(self.weights() > 0.0, self._trace(), np.float32(0.0)).max(axis=0))
        return np.where(np.isnan(self.covariance[0, ..., 0]), np.float32(np.nan), worst)

    def _trace(self) -> Float32Array:
        trace: Float32Array = self.covariance[..., 0] + self.covariance[..., 2]
        return trace


def walkable(grid_map: GridMap) -> BoolArray:
    """Nodes where people can walk by the plan, shape (rows, columns); all nodes without one."""
    if grid_map.obstacle is None:
        return np.ones(grid_map.shape, dtype=bool)
    open_: BoolArray = grid_map.obstacle < WALKABLE_DEPTH_M
    return open_


def forecast_accuracy(
    grid_map: GridMap, errors: WalkerErrors = PHONE, *, max_nodes: int = MAX_NODES
) -> AccuracyForecast:
    """Expected accuracy at each node of a map, for a walker who came straight to it in each of eight directions.

    The walker enters a line where it becomes walkable, with the start's uncertainty, and takes a reading at each mapped
    node; over unmapped ground only dead reckoning goes on.

    Raises
    ------
    MapError
        The map is smaller than two by two nodes.
    """
    rows, columns = _part(grid_map.mapped, max_nodes)
    at = np.ix_(rows, columns)
    row, column = (part.ravel() for part in np.meshgrid(rows, columns, indexing="ij"))
    shape = (len(rows), len(columns))
    nodes = _nodes_at(grid_map, row, column).reshape(*shape, -1, 4)
    open_, mapped = walkable(grid_map)[at], grid_map.mapped[at]
    share, white = _noise(grid_map, errors)
    covariance = np.full((len(_MOVES), *shape, 3), np.nan, np.float32)
    approach = np.zeros((len(_MOVES), *shape), np.float32)
    vector, q = grid_map.features is FeatureSet.VECTOR, errors.kernel_parameters()
    cell = grid_map.cell_m * (int(rows[1] - rows[0]) if len(rows) > 1 else 1)
    for k, move in enumerate(_MOVES):
        kernel.scan(nodes, open_, mapped, cell, np.array(move), share, white, vector, q, covariance[k], approach[k])
    first = (grid_map.x0 + columns[0] * grid_map.cell_m, grid_map.y0 + rows[0] * grid_map.cell_m)
    return AccuracyForecast(*first, cell, covariance, approach)


def _part(mapped: BoolArray, max_nodes: int) -> tuple[IntArray, IntArray]:
    """Rows and columns that hold mapped nodes, evenly thinned to so many nodes at most; at least two of each."""
    parts = []
    for axis in (0, 1):
        held = np.flatnonzero(mapped.any(axis=1 - axis))
        last = mapped.shape[axis] - 1
        lo, hi = (int(held[0]), int(held[-1])) if len(held) else (0, 0)
        lo = max(min(lo, last - 1), 0)
        parts.append((lo, min(max(hi, lo + 1), last) + 1))
    (r0, r1), (c0, c1) = parts
    every = max(math.ceil(math.sqrt((r1 - r0) * (c1 - c0) / max_nodes)), 1)
    return np.arange(r0, r1, every), np.arange(c0, c1, every)


@dataclass(frozen=True, slots=True, eq=False)
class RouteForecast:
    """Expected accuracy along a planned route, at points 0.5 m apart.

    Attributes
    ----------
    way : array, shape (n,), m
        Walked so far.
    xy : array, shape (n, 2), m, level frame
    mapped : array, shape (n,), bool
    along, across, error : arrays, shape (n,), m
        Standard deviation along and across the way; root mean square distance.
    """

    way: Float64Array
    xy: Float64Array
    mapped: BoolArray
    along: Float64Array
    across: Float64Array
    error: Float64Array

    def __len__(self) -> int:
        return len(self.way)


def forecast_route(grid_map: GridMap, route: Float64Array, errors: WalkerErrors = PHONE) -> RouteForecast:
    """Expected accuracy along a route.

    Parameters
    ----------
    grid_map : GridMap
    route : array, shape (k, 2), m, level frame
        Corners; straight lines between them.
    errors : WalkerErrors

    Raises
    ------
    InputError
        Fewer than two different points.
    MapError
        The map is smaller than two by two nodes.
    """
    way, xy = resample(route, ROUTE_STEP_M)
    leg = np.diff(xy, axis=0)
    ds = np.hypot(leg[:, 0], leg[:, 1])
    c, s = np.append(leg[:1, 0] / ds[:1], leg[:, 0] / ds), np.append(leg[:1, 1] / ds[:1], leg[:, 1] / ds)
    row, column, inside = nearest_nodes(grid_map, xy)
    mapped = inside & grid_map.mapped[row, column]
    share, white = _noise(grid_map, errors)
    covariance = np.empty((len(xy), 3))
    kernel.along(
        _nodes_at(grid_map, row, column), mapped, np.append(ds[:1], ds), c, s, share, white,
        grid_map.features is FeatureSet.VECTOR, errors.kernel_parameters(), covariance,
    )  # fmt: skip
    xx, xy_, yy = covariance.T
    return RouteForecast(
        way=way,
        xy=xy,
        mapped=mapped,
        along=np.sqrt(np.maximum(c * c * xx + 2 * c * s * xy_ + s * s * yy, 0.0)),
        across=np.sqrt(np.maximum(s * s * xx - 2 * c * s * xy_ + c * c * yy, 0.0)),
        error=np.sqrt(xx + yy),
    )


def resample(route: Float64Array, step_m: float) -> tuple[Float64Array, Float64Array]:
    """Points at most ``step_m`` apart, evenly along each leg, corners kept: way (n,) and points (n, 2), m."""
    route = np.asarray(route, dtype=np.float64)
    if route.ndim != 2 or route.shape[1] != 2 or not np.isfinite(route).all():
        raise InputError("route", f"needs finite points of shape (n, 2), got {route.shape}")
    legs = np.hypot(*np.diff(route, axis=0).T) if len(route) > 1 else np.empty(0)
    keep = np.append(True, legs > 1e-6)
    route, legs = route[keep], legs[legs > 1e-6]
    if not len(legs):
        raise InputError("route", "needs two different points at least")
    corner = np.append(0.0, np.cumsum(legs))
    parts = np.maximum(np.ceil(legs / step_m).astype(np.int64), 1)
    way = np.concatenate(
        [a + (b - a) * np.arange(n) / n for a, b, n in zip(corner[:-1], corner[1:], parts, strict=True)] + [corner[-1:]]
    )
    return way, np.stack([np.interp(way, corner, route[:, 0]), np.interp(way, corner, route[:, 1])], axis=1)


def nearest_nodes(grid_map: GridMap, xy: Float64Array) -> tuple[IntArray, IntArray, BoolArray]:
    """Row and column of the node nearest to each point, and whether the point lies on the grid."""
    rows, columns = grid_map.shape
    c = np.rint((xy[:, 0] - grid_map.x0) / grid_map.cell_m).astype(np.int64)
    r = np.rint((xy[:, 1] - grid_map.y0) / grid_map.cell_m).astype(np.int64)
    inside = (r >= 0) & (r < rows) & (c >= 0) & (c < columns)
    return np.clip(r, 0, rows - 1), np.clip(c, 0, columns - 1), inside


def _noise(grid_map: GridMap, errors: WalkerErrors) -> tuple[Float64Array, Float64Array]:
    variance = np.maximum(np.array(grid_map.noise_sd, dtype=np.float64), 0.05) ** 2
    return errors.shared * variance, (1.0 - errors.shared) * variance


def _nodes_at(grid_map: GridMap, row: IntArray, column: IntArray) -> Float32Array:
    """Mean, slopes along x and y, variance of the map at some nodes, shape (n, channels, 4)."""
    if min(grid_map.shape) < 2:
        raise MapError("a map needs at least two by two nodes")
    rows, columns = grid_map.shape
    mean, cell = grid_map.mean, grid_map.cell_m
    up, down = np.minimum(row + 1, rows - 1), np.maximum(row - 1, 0)
    right, left = np.minimum(column + 1, columns - 1), np.maximum(column - 1, 0)
    nodes = np.empty((len(row), mean.shape[0], 4), dtype=np.float32)
    nodes[..., 0] = mean[:, row, column].T
    nodes[..., 1] = ((mean[:, row, right] - mean[:, row, left]) / ((right - left) * cell)).T
    nodes[..., 2] = ((mean[:, up, column] - mean[:, down, column]) / ((up - down) * cell)).T
    nodes[..., 3] = (grid_map.sd[:, row, column] ** 2).T
    return nodes
