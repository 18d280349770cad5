"""Contour search: all shifts of a track, and all shifts over rotations and scales."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import map_coordinates

from app.engine.matching import MatchProblem, Profile, Region, Track, read_map
from app.engine.matching.criteria import Criterion
from app.engine.matching.lattice import LatticeMap
from app.engine.matching.magcom import Magcom, MagcomParameters
from app.engine.types import FeatureSet, Float32Array, Float64Array, GridMap
from app.evaluation.kernels.fields import random_map
from app.evaluation.kernels.runner import Comparison, Units

POINTS, SHIFTS = 300, 200
ROTATIONS, SCALES = 21, 5
_TIMED = 200
"""Shifts that the peer does of all."""


def magcom_mad(rng: np.random.Generator) -> Comparison:
    """MAD of 300 points, one channel, at 200 x 200 shifts by whole cells, bilinear between them."""
    grid_map = random_map(rng, FeatureSet.TOTAL, (600, 600))
    xy = _walk(rng)
    values = _read(grid_map, xy) + rng.standard_normal((POINTS, 1))
    column, row = (0.5 * (600 - SHIFTS) + xy / grid_map.cell_m).T
    high = (float(row.max()) + SHIFTS, float(column.max()) + SHIFTS)
    lattice = LatticeMap.of(
        grid_map.mean,
        grid_map.mapped,
        pitch=1,
        reference=values.mean(axis=0),
        low=(float(row.min()), float(column.min())),
        high=high,
    )
    points = lattice.points(row, column, values)

    def ours() -> Float32Array:
        return lattice.costs(points, (SHIFTS, SHIFTS), Criterion.MAD, centre=False, mapped=0.5)

    def peer() -> Float64Array:
        """The middle row of shifts."""
        return _row_of_shifts(grid_map.mean[0], row + SHIFTS // 2, column, values[:, 0])

    return Comparison(ours, peer, _units("search of 300 points over 200 x 200 shifts", SHIFTS**2))


def magcom_pose(rng: np.random.Generator) -> Comparison:
    """The same over 21 headings x 5 scales, as a whole match: search, best places between the cells, judgement."""
    grid_map = random_map(rng, FeatureSet.TOTAL, (600, 600))
    xy = _walk(rng) + 150.0
    values = _read(grid_map, xy) + 0.5 * rng.standard_normal((POINTS, 1))
    away, half = xy - xy[0], 0.5 * SHIFTS * grid_map.cell_m
    c, s = np.cos(0.05) / 1.02, np.sin(0.05) / 1.02
    x, y = xy[0, 0] + 4.0 + c * away[:, 0] - s * away[:, 1], xy[0, 1] - 3.0 + s * away[:, 0] + c * away[:, 1]
    track = Track(np.arange(float(POINTS)), x, y, np.zeros(POINTS), np.zeros((POINTS, 2, 2)))
    region = Region(float(x[0]), float(y[0]), np.eye(2) * (half / 3.0) ** 2, heading_sd=0.06, scale_sd=0.02)
    problem = MatchProblem(Profile(FeatureSet.TOTAL, values, np.array([0.5])), track, grid_map, region)
    matcher = Magcom(MagcomParameters(rotations=ROTATIONS, scales=SCALES))
    row, column = y / grid_map.cell_m, x / grid_map.cell_m - SHIFTS // 2

    def peer() -> Float64Array:
        return _row_of_shifts(grid_map.mean[0], row, column, values[:, 0])

    units = _units("match of 300 points over 200 x 200 cells, 21 headings, 5 scales", SHIFTS**2 * ROTATIONS * SCALES)
    return Comparison(lambda: matcher.match(problem), peer, units)


def _units(what: str, shifts: int) -> Units:
    return Units(
        what,
        f"scipy map_coordinates per shift (scaled from {_TIMED} of {shifts:,})",
        theirs=_TIMED / shifts,
    )


def _row_of_shifts(plane: Float32Array, row: Float64Array, column: Float64Array, values: Float64Array) -> Float64Array:
    """MAD at successive shifts along a row, one read of the map each."""
    return np.array([np.abs(map_coordinates(plane, [row, column + k], order=1) - values).mean() for k in range(_TIMED)])


def _walk(rng: np.random.Generator) -> Float64Array:
    """A winding way of 300 points, 0.3 m apart, about its middle, m."""
    heading = np.cumsum(0.06 * rng.standard_normal(POINTS))
    xy = np.cumsum(0.3 * np.stack([np.cos(heading), np.sin(heading)], axis=1), axis=0)
    return np.asarray(xy - 0.5 * (xy.min(axis=0) + xy.max(axis=0)))


def _read(grid_map: GridMap, xy: Float64Array) -> Float64Array:
    return read_map(grid_map, FeatureSet.TOTAL, xy[:, 0], xy[:, 1]).mean
