"""First search of contour matching: all shifts of a region on a coarse map, over rotations and scales."""

from __future__ import annotations

import time
from dataclasses import dataclass
from itertools import product

import numpy as np

from app.engine.errors import InputError
from app.engine.kernels.contour import keep_lowest
from app.engine.kernels.lanes_contour import ROWS
from app.engine.matching.criteria import Criterion
from app.engine.matching.field import features_of
from app.engine.matching.lattice import LatticeMap
from app.engine.matching.peaks import local_minima
from app.engine.matching.placements import placed, turned_vectors
from app.engine.matching.problem import MatchProblem, Profile
from app.engine.types import FeatureSet, Float64Array

_TURN_SD, _SCALE_SD = 0.1, 0.1
"""rad, -: of the track's shape where no region says better."""
_MOST_POSES = 2001
_MOST_CELLS = 50_000_000
_BAND = 3e7
"""Readings compared between two looks at the clock."""


@dataclass(frozen=True, slots=True)
class MagcomParameters:
    """Of the contour search.

    Attributes
    ----------
    criterion : Criterion
        What measures the agreement.
    features : FeatureSet
        Compared at most; less where profile or map have less.
    sigmas : float
        Half size of the search region, rotations and scales, in standard deviations of the prior.
    rotations : int
        Headings tried, evenly over the range; 1 keeps the indicated one, 0 takes as many as the track's extent needs.
    scales : int
        Likewise of the track's stretch.
    centre : bool
        Take the mean difference of each channel off first if the profile's sensor has an offset.
    coarse : int
        Cells of the map that are one step of the first search.
    kept : int
        Places of the first search that are followed up.
    listed : int
        Of these, places brought to their very best and judged.
    mapped : float
        Least share of a placement that must lie on mapped ground.
    """

    criterion: Criterion = Criterion.MAD
    features: FeatureSet = FeatureSet.VECTOR
    sigmas: float = 3.0
    rotations: int = 1
    scales: int = 1
    centre: bool = True
    coarse: int = 2
    kept: int = 30
    listed: int = 16
    mapped: float = 0.5


@dataclass(frozen=True, slots=True)
class Found:
    """Places of the first search.

    Attributes
    ----------
    placements : array, shape (p, 4)
        Shift (m), rotation (rad) and scale about the track's first point; best first.
    evaluated : int
    complete : bool
        It came to its end before the deadline.
    """

    placements: Float64Array
    evaluated: int
    complete: bool


@dataclass(frozen=True, slots=True)
class Box:
    """Where placements are searched: bounds of the shift (m), rotations (rad) and scales tried."""

    low: Float64Array
    high: Float64Array
    rotations: Float64Array
    scales: Float64Array

    @property
    def poses(self) -> Float64Array:
        """Rotations and scales, from the indicated ones outwards: a deadline leaves out the unlikely; shape (p, 2)."""
        rotation, scale = (part.ravel() for part in np.meshgrid(self.rotations, self.scales, indexing="ij"))
        far = (rotation / max(np.abs(self.rotations).max(), 1e-9)) ** 2
        far += ((scale - 1.0) / max(np.abs(self.scales - 1.0).max(), 1e-9)) ** 2
        return np.column_stack([rotation, scale])[np.argsort(far, kind="stable")]

    @property
    def bounds(self) -> tuple[Float64Array, Float64Array]:
        """Of placements, shape (4,) each."""
        low = np.array([*self.low, self.rotations.min(), self.scales.min()])
        return low, np.array([*self.high, self.rotations.max(), self.scales.max()])


def search_box(problem: MatchProblem, p: MagcomParameters) -> Box:
    """Shifts that the prior allows and that leave enough of the track on the map."""
    x, y = problem.track.x, problem.track.y
    x_min, y_min, x_max, y_max = problem.grid_map.extent
    need = max(int(np.ceil(p.mapped * len(x))), 1)
    region = problem.region
    turn, stretch = (_TURN_SD, _SCALE_SD) if region is None else (region.heading_sd, region.scale_sd)
    extent = float(np.sqrt(np.var(x) + np.var(y)))
    step = p.coarse * problem.grid_map.cell_m / max(extent, 1e-9)
    rotations, scales = _spread(p.rotations, p.sigmas * turn, step), 1.0 + _spread(p.scales, p.sigmas * stretch, step)
    scales = scales[scales > 0.05]
    if len(rotations) * len(scales) > _MOST_POSES:
        raise InputError(
            "rotations", f"{len(rotations)} rotations and {len(scales)} scales: at most {_MOST_POSES} poses"
        )
    # the n-th point from either side must be on the map; a turned or stretched track lies otherwise about its first
    slack = np.zeros(2)
    if len(rotations) * len(scales) > 1:
        reach = float(np.hypot(x - x[0], y - y[0]).max())
        slack += reach * (2.0 * np.sin(0.5 * min(np.ptp(rotations), np.pi)) + np.abs(scales - 1.0).max())
    low = np.array([x_min - np.sort(x)[-need], y_min - np.sort(y)[-need]]) - slack
    high = np.array([x_max - np.sort(x)[need - 1], y_max - np.sort(y)[need - 1]]) + slack
    if region is not None:
        centre, half = np.array([region.x - x[0], region.y - y[0]]), np.array(region.half_widths(p.sigmas))
        low, high = np.maximum(low, centre - half), np.minimum(high, centre + half)
    return Box(low, high, rotations, scales)


def _spread(count: int, half: float, step: float) -> Float64Array:
    """Offsets from ``-half`` to ``half``, symmetric about 0: ``count`` of them, or steps small enough."""
    if count == 0:
        count = 2 * int(np.ceil(half / step)) + 1 if step * _MOST_POSES > half else 2 * _MOST_POSES
    return np.linspace(-half, half, count) if count > 1 and half > 0.0 else np.zeros(1)


def first_search(problem: MatchProblem, profile: Profile, box: Box, p: MagcomParameters, until: float) -> Found:
    """Lowest places over the lattice of shifts on the coarse map, over all rotations and scales.

    Raises
    ------
    InputError
        The track, as it may be turned, reaches over more map than can be held.
    """
    grid_map, pitch = problem.grid_map, p.coarse
    xy, values = thinned(problem.track.xy, profile.values, pitch * grid_map.cell_m)
    columns, rows = (int(reach / (pitch * grid_map.cell_m) + 1e-9) + 1 for reach in box.high - box.low)
    poses = box.poses
    x, y = placed(xy, box.low[0], box.low[1], poses[:, :1], poses[:, 1:])
    column, row = (x - grid_map.x0) / grid_map.cell_m, (y - grid_map.y0) / grid_map.cell_m
    lattice = _lattice(problem, profile, values, row, column, (rows * pitch, columns * pitch), pitch)
    turning = profile.features is FeatureSet.VECTOR
    readings = turned_vectors(values, poses[:, 0]) if turning else np.broadcast_to(values, (len(poses), *values.shape))
    tracks = lattice.points(row, column, readings)
    lowest, which = np.full((rows, columns), np.inf, dtype=np.float32), np.zeros((rows, columns), dtype=np.int64)
    band, evaluated, complete = _band(p.criterion, len(xy), columns), 0, True
    for k, first in product(range(len(poses)), range(0, rows, band)):
        shape = (min(band, rows - first), columns)
        track = tracks[k].moved(first)
        cost = lattice.costs(track, shape, p.criterion, centre=centres(profile, p), mapped=p.mapped)
        keep_lowest(cost, k, lowest[first : first + band], which[first : first + band])
        evaluated += cost.size
        if time.thread_time() > until:
            complete = evaluated == len(poses) * rows * columns
            break
    at = local_minima(lowest, p.kept)
    shift = box.low + pitch * grid_map.cell_m * at[:, ::-1]
    return Found(np.column_stack([shift, poses[which[at[:, 0], at[:, 1]]]]), evaluated, complete)


def _band(criterion: Criterion, n: int, columns: int) -> int:
    """Rows of shifts between two looks at the clock: some milliseconds of work."""
    readings = 50 * n * n if criterion is Criterion.HAUSDORFF else n
    return max(ROWS * int(_BAND // (ROWS * readings * columns)), ROWS)


def _lattice(
    problem: MatchProblem,
    profile: Profile,
    values: Float64Array,
    row: Float64Array,
    column: Float64Array,
    shifts: tuple[int, int],
    pitch: int,
) -> LatticeMap:
    """The coarse map under tracks at ``row`` and ``column`` (p, n; cells) and all their shifts."""
    low = float(row.min()), float(column.min())
    high = float(row.max()) + shifts[0], float(column.max()) + shifts[1]
    if (high[0] - low[0]) * (high[1] - low[1]) > _MOST_CELLS:
        raise InputError("track", f"searched over more than {_MOST_CELLS} cells of the map: cut it, or give a region")
    return LatticeMap.of(
        features_of(problem.grid_map, profile.features)[0],
        problem.grid_map.mapped,
        pitch=pitch,
        reference=values.mean(axis=0),
        low=low,
        high=high,
    )


def thinned(xy: Float64Array, values: Float64Array, spacing_m: float) -> tuple[Float64Array, Float64Array]:
    """Means over as many successive points as lie ``spacing_m`` apart: what a coarse map can be compared with."""
    way = float(np.hypot(*np.diff(xy, axis=0).T).sum())
    group = max(int(spacing_m * max(len(xy) - 1, 1) / max(way, 1e-9) + 1e-9), 1) if way > 0.0 else 1
    if group == 1:
        return xy, values
    starts = np.arange(0, len(xy), group)
    counts = np.diff(np.append(starts, len(xy)))[:, None]
    return np.add.reduceat(xy, starts) / counts, np.add.reduceat(values, starts) / counts


def centres(profile: Profile, p: MagcomParameters) -> bool:
    """Whether mean differences are taken off: wanted, and the sensor has an offset."""
    return p.centre and profile.offset_sd > 0.0
