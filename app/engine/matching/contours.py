"""Contours of a map: where it has a value, and where it has it nearest to a point."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from app.engine.kernels.contours import FOUND, nearest_points
from app.engine.matching.field import features_of
from app.engine.types import BoolArray, FeatureSet, Float32Array, Float64Array, GridMap

Box = tuple[float, float, float, float]
"""x_min, y_min, x_max, y_max, m, level frame."""


@dataclass(frozen=True, slots=True)
class NearestPoints:
    """Points of contours nearest to n points, one channel.

    Attributes
    ----------
    xy : array, shape (n, 2), m, level frame
        The points asked for where nothing was found.
    gradient : array, shape (n, 2), uT/m
        Of the map, there.
    distance : array, shape (n,), m
        Infinite where nothing was found.
    """

    xy: Float64Array
    gradient: Float64Array
    distance: Float64Array

    @property
    def found(self) -> BoolArray:
        """Where a contour lies within reach, shape (n,)."""
        return np.isfinite(self.distance)


@dataclass(frozen=True, slots=True, eq=False)
class ContourMap:
    """A map in some features, as contours see it: bilinear between nodes, nothing where it is not mapped.

    Attributes
    ----------
    grid_map : GridMap
    features : FeatureSet
    planes, sd : array, shape (channels, rows, columns), float32, uT
        Mean and standard deviation; the mean of unmapped nodes is not a number.
    """

    grid_map: GridMap
    features: FeatureSet
    planes: Float32Array
    sd: Float32Array

    @classmethod
    def of(cls, grid_map: GridMap, features: FeatureSet, box: Box | None = None) -> ContourMap:
        """Of a map, or of its part that holds a box, in features that it has or that need less."""
        grid_map = grid_map if box is None else part_of(grid_map, box)
        mean, sd = features_of(grid_map, features)
        planes = np.where(grid_map.mapped[None], mean, np.float32(np.nan))
        return cls(grid_map, features, np.ascontiguousarray(planes), np.ascontiguousarray(sd))

    def cells(self, xy: Float64Array) -> Float64Array:
        """Column and row of points of shape (n, 2), m."""
        return (xy - (self.grid_map.x0, self.grid_map.y0)) / self.grid_map.cell_m

    def metres(self, cells: Float64Array) -> Float64Array:
        """The inverse of :meth:`cells`."""
        return cells * self.grid_map.cell_m + (self.grid_map.x0, self.grid_map.y0)

    def nearest(self, channel: int, xy: Float64Array, values: Float64Array, radius_m: float) -> NearestPoints:
        """Nearest points of the contours of ``values`` (shape (n,), uT) to points of shape (n, 2), m."""
        at, cell = self.cells(xy), self.grid_map.cell_m
        out = np.empty((len(at), FOUND))
        nearest_points(
            self.planes[channel],
            np.ascontiguousarray(at[:, 0]),
            np.ascontiguousarray(at[:, 1]),
            np.ascontiguousarray(values, dtype=np.float64),
            radius_m / cell,
            out,
        )
        return NearestPoints(self.metres(out[:, :2]), out[:, 2:4] / cell, out[:, 4] * cell)

    def crossings(self, channel: int, value: float) -> Float64Array:
        """Where the contour of a value crosses the lines between neighbouring nodes, shape (k, 2), m."""
        return self.metres(edge_crossings(self.planes[channel], value))

    def band(self, values: Float64Array, tolerance: Float64Array) -> Float64Array:
        """Points of contours widened by a tolerance, in all channels at once, shape (k, 2), m.

        Nodes within the tolerance, and, so that a band narrower than the cells is not lost between them, crossings of
        each channel's contour with the lines between nodes that are within the tolerance of the other channels, give or
        take what these change by over half a cell.

        Parameters
        ----------
        values, tolerance : array, shape (channels,), uT
        """
        with np.errstate(invalid="ignore"):
            near = np.all(np.abs(self.planes - values[:, None, None]) <= tolerance[:, None, None], axis=0)
        rows, columns = np.nonzero(near)
        found = [np.stack([columns, rows], axis=1).astype(np.float64)]
        slack = 0.5 * self._steepness()
        for channel, value in enumerate(values):
            points = edge_crossings(self.planes[channel], float(value))
            column, row = np.rint(points).astype(np.int64).T
            with np.errstate(invalid="ignore"):
                away = np.abs(self.planes[:, row, column] - values[:, None])
            away[channel] = 0.0  # on its contour
            found.append(points[np.all(away <= tolerance[:, None] + slack[:, row, column], axis=0)])
        return self.metres(np.concatenate(found))

    def _steepness(self) -> Float64Array:
        """Change over a cell along the gradient, shape (channels, rows, columns), uT; nothing beside unmapped nodes."""
        change = np.zeros(self.planes.shape)
        rows, columns = self.grid_map.shape
        with np.errstate(invalid="ignore"):
            if columns > 1:
                change += np.nan_to_num(np.gradient(self.planes, axis=2)) ** 2
            if rows > 1:
                change += np.nan_to_num(np.gradient(self.planes, axis=1)) ** 2
        steepness: Float64Array = np.sqrt(change)
        return steepness


def part_of(grid_map: GridMap, box: Box) -> GridMap:
    """The smallest part of a map that holds a box; one node at least."""
    rows, columns = grid_map.shape
    spans = []
    for low, high, origin, nodes in ((box[0], box[2], grid_map.x0, columns), (box[1], box[3], grid_map.y0, rows)):
        first = min(max(int(np.floor((low - origin) / grid_map.cell_m)), 0), nodes - 1)
        spans.append((first, max(min(int(np.ceil((high - origin) / grid_map.cell_m)), nodes - 1), first) + 1))
    (left, right), (bottom, top) = spans
    nodes_of = np.s_[bottom:top, left:right]
    return replace(
        grid_map,
        x0=grid_map.x0 + left * grid_map.cell_m,
        y0=grid_map.y0 + bottom * grid_map.cell_m,
        mean=grid_map.mean[:, *nodes_of],
        sd=grid_map.sd[:, *nodes_of],
        support=grid_map.support[nodes_of],
        obstacle=None,
        radio=None,
    )


def edge_crossings(plane: Float32Array, value: float) -> Float64Array:
    """Crossings of a contour with the lines between neighbouring nodes, shape (k, 2): column, row.

    The map is linear along these lines: the crossings are exact. A node counts as below if it has the value itself, so
    no crossing is told twice, and a plateau has its edge where it ends towards higher ground.
    """
    plane = plane.astype(np.float64)
    below = plane <= value
    known = np.isfinite(plane)
    found = []
    for along in (0, 1):
        a, b = (np.s_[:, :-1], np.s_[:, 1:]) if along == 0 else (np.s_[:-1], np.s_[1:])
        rows, columns = np.nonzero((below[a] != below[b]) & known[a] & known[b])
        first, second = plane[a][rows, columns], plane[b][rows, columns]
        points = np.stack([columns, rows], axis=1).astype(np.float64)
        points[:, along] += (value - first) / (second - first)
        found.append(points)
    return np.concatenate(found)
