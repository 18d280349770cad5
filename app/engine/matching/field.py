"""The map under a placement of the track."""

from __future__ import annotations

from dataclasses import dataclass
from weakref import WeakKeyDictionary

import numpy as np

from app.engine.matching.problem import RouteMap, reduce_features
from app.engine.types import BoolArray, FeatureSet, Float32Array, Float64Array, GridMap

_reduced: WeakKeyDictionary[GridMap, dict[FeatureSet, tuple[Float32Array, Float32Array]]] = WeakKeyDictionary()


@dataclass(frozen=True, slots=True)
class MapReading:
    """Map at n points: ``mean``, ``sd`` shape (n, channels), uT; ``gradient`` (n, channels, 2), uT/m; ``mapped`` (n,);
    ``support`` (n,), m, distance to the nearest survey sample.

    Outside the grid the nearest node is read and nothing is mapped.
    """

    mean: Float64Array
    sd: Float64Array
    gradient: Float64Array
    mapped: BoolArray
    support: Float64Array


def read_map(grid_map: GridMap, features: FeatureSet, x: Float64Array, y: Float64Array) -> MapReading:
    """Bilinear mean, standard deviation and gradient of the map at points (m, level frame), in these features."""
    rows, columns = grid_map.shape
    u, v = (x - grid_map.x0) / grid_map.cell_m, (y - grid_map.y0) / grid_map.cell_m
    c = np.clip(np.floor(u), 0, max(columns - 2, 0)).astype(np.int64)
    r = np.clip(np.floor(v), 0, max(rows - 2, 0)).astype(np.int64)
    c1, r1 = np.minimum(c + 1, columns - 1), np.minimum(r + 1, rows - 1)
    fu, fv = np.clip(u - c, 0.0, 1.0), np.clip(v - r, 0.0, 1.0)
    mean, sd = features_of(grid_map, features)
    corners = [mean[:, r, c], mean[:, r, c1], mean[:, r1, c], mean[:, r1, c1]]
    m00, m01, m10, m11 = (np.asarray(corner, dtype=np.float64) for corner in corners)
    low, high = m00 + fu * (m01 - m00), m10 + fu * (m11 - m10)
    slope_x = ((1.0 - fv) * (m01 - m00) + fv * (m11 - m10)) / grid_map.cell_m
    slope_y = (high - low) / grid_map.cell_m
    s = [np.asarray(sd[:, a, b], dtype=np.float64) for a, b in ((r, c), (r, c1), (r1, c), (r1, c1))]
    spread = (1.0 - fv) * ((1.0 - fu) * s[0] + fu * s[1]) + fv * ((1.0 - fu) * s[2] + fu * s[3])
    inside = (u >= 0.0) & (u <= columns - 1) & (v >= 0.0) & (v <= rows - 1)
    support = grid_map.support[np.where(fv > 0.5, r1, r), np.where(fu > 0.5, c1, c)]
    return MapReading(
        mean=(low + fv * (high - low)).T,
        sd=spread.T,
        gradient=np.stack([slope_x.T, slope_y.T], axis=2),
        mapped=inside & (support <= grid_map.mapped_m),
        support=support.astype(np.float64),
    )


def features_of(grid_map: GridMap, features: FeatureSet) -> tuple[Float32Array, Float32Array]:
    """Mean and standard deviation of the map in features that it has or that need less, (channels, rows, columns).

    Remembered as long as the map lives.
    """
    if features is grid_map.features:
        return grid_map.mean, grid_map.sd
    known = _reduced.setdefault(grid_map, {})
    if features not in known:
        known[features] = _reduce(grid_map, features)
    return known[features]


def _reduce(grid_map: GridMap, features: FeatureSet) -> tuple[Float32Array, Float32Array]:
    mean, sd = (np.moveaxis(part, 0, -1).astype(np.float64) for part in (grid_map.mean, grid_map.sd))
    reduced = reduce_features(mean, sd, grid_map.features, features)
    first, second = (np.ascontiguousarray(np.moveaxis(part, -1, 0), dtype=np.float32) for part in reduced)
    return first, second


def route_along(
    grid_map: GridMap, xy: Float64Array, spacing_m: float, features: FeatureSet | None = None
) -> RouteMap | None:
    """Map along a line of the level, resampled by distance; None if the line is shorter than four points.

    Parameters
    ----------
    grid_map : GridMap
    xy : array, shape (k, 2), m, level frame
    spacing_m : float, m
    features : FeatureSet or None
        None: the map's own.
    """
    features = features or grid_map.features
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(xy, axis=0).T))])
    moving = np.concatenate([[True], np.diff(way) > 0.0])
    s = np.arange(0.0, float(way[-1]) + 1e-9, spacing_m)
    if s.shape[0] < 4:
        return None
    x, y = np.interp(s, way[moving], xy[moving, 0]), np.interp(s, way[moving], xy[moving, 1])
    reading = read_map(grid_map, features, x, y)
    return RouteMap(spacing_m, x, y, reading.mean, reading.sd, features)
