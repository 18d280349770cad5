"""How good a map is: what of the walkable space it covers, and where its sources disagree."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage, stats

from app.engine.errors import InputError
from app.engine.mapping.forecast import nearest_nodes, walkable
from app.engine.types import BoolArray, Evidence, Float32Array, Float64Array, GridMap, Int32Array, IntArray

CONFLICT_CELL_M = 1.0
MIN_REGION_M2 = 10.0
MAX_REGIONS = 50
LEVEL_OF_CONFLICT = 0.01
"""Chance that sources which agree are called in conflict, per cell."""
_LEAST_NOISE_UT = 0.3
_NEAR_M = 8.0
"""Without a plan, ground this near to a mapped node counts as walkable: more is not known of the level."""
_OFFSET_CELLS = 5
"""Shared cells from which on a source's own offset is worth taking out."""
_ROUNDS = 5


@dataclass(frozen=True, slots=True)
class Region:
    """A connected part of the walkable space: ``box`` is ``(x_min, y_min, x_max, y_max)``, m."""

    box: tuple[float, float, float, float]
    area_m2: float
    mapped_share: float


@dataclass(frozen=True, slots=True)
class CoverageSummary:
    """What of the walkable space is mapped.

    Attributes
    ----------
    by_plan : bool
        Whether the walkable space is that of the floor plan; without one it is what lies within 8 m of mapped ground.
    walkable_m2, mapped_m2 : float, m^2
    mapped_share : float
        Of the walkable space.
    support_m : tuple of float, m
        Distance of walkable ground to the nearest survey sample: median and 90th percentile (capped as the map's).
    regions : tuple of Region
        Connected parts of at least 10 m^2, largest first, at most 50.
    """

    by_plan: bool
    walkable_m2: float
    mapped_m2: float
    mapped_share: float
    support_m: tuple[float, float]
    regions: tuple[Region, ...]


def walkable_space(grid_map: GridMap) -> BoolArray:
    """Ground to be mapped, shape (rows, columns): the plan's, else what lies near mapped ground."""
    if grid_map.obstacle is not None:
        return walkable(grid_map)
    if not grid_map.mapped.any():
        return np.zeros(grid_map.shape, dtype=bool)
    near: BoolArray = ndimage.distance_transform_edt(~grid_map.mapped) * grid_map.cell_m <= _NEAR_M
    return near


def summarize_coverage(grid_map: GridMap) -> CoverageSummary:
    """Shares of the walkable space, as a whole and per connected part."""
    space, mapped, cell = walkable_space(grid_map), grid_map.mapped, grid_map.cell_m**2
    covered = space & mapped
    support = grid_map.support[space]
    middle, far = np.percentile(support, (50, 90)) if support.size else (np.nan, np.nan)
    return CoverageSummary(
        by_plan=grid_map.obstacle is not None,
        walkable_m2=float(space.sum() * cell),
        mapped_m2=float(covered.sum() * cell),
        mapped_share=float(covered.sum() / max(int(space.sum()), 1)),
        support_m=(float(middle), float(far)),
        regions=_regions(grid_map, space, covered),
    )


def _regions(grid_map: GridMap, space: BoolArray, covered: BoolArray) -> tuple[Region, ...]:
    label, count = ndimage.label(space, structure=np.ones((3, 3)))
    size = np.bincount(label.ravel(), minlength=count + 1)
    known = np.bincount(label[covered], minlength=count + 1)
    boxes, cell = ndimage.find_objects(label), grid_map.cell_m
    order = [k for k in np.argsort(-size[1:], kind="stable") + 1 if size[k] * cell**2 >= MIN_REGION_M2]
    return tuple(
        Region(
            box=(
                grid_map.x0 + boxes[k - 1][1].start * cell,
                grid_map.y0 + boxes[k - 1][0].start * cell,
                grid_map.x0 + (boxes[k - 1][1].stop - 1) * cell,
                grid_map.y0 + (boxes[k - 1][0].stop - 1) * cell,
            ),
            area_m2=float(size[k] * cell**2),
            mapped_share=float(known[k] / size[k]),
        )
        for k in order[:MAX_REGIONS]
    )


@dataclass(frozen=True, slots=True, eq=False)
class ConflictView:
    """Where sources of a map's evidence disagree, on cells of a metre.

    Cell ``[r, c]`` covers ``x0 + c .. x0 + c + 1`` metres, likewise ``y``.

    Attributes
    ----------
    x0, y0, cell_m : float, m
        Corner and size of the cells.
    sources : array, shape (rows, columns), int32
        Number of sources that were there.
    ratio : array, shape (rows, columns), float32
        Variance between sources over what their noise accounts for, mean of the channels; about 1 where they agree, NaN
        with fewer than two.
    limit : array, shape (rows, columns), float32
        The ratio that one in a hundred cells would exceed by noise alone.
    """

    x0: float
    y0: float
    cell_m: float
    sources: Int32Array
    ratio: Float32Array
    limit: Float32Array

    @property
    def conflict(self) -> BoolArray:
        """Cells in conflict, shape (rows, columns)."""
        mask: BoolArray = self.ratio > self.limit
        return mask

    def at_nodes(self, grid_map: GridMap) -> tuple[Float32Array, Int32Array, BoolArray]:
        """Ratio, number of sources and conflict at each node of a map, shape (rows, columns)."""
        rows, columns = grid_map.shape
        x = grid_map.x0 + grid_map.cell_m * np.arange(columns)
        y = grid_map.y0 + grid_map.cell_m * np.arange(rows)
        r, c = np.floor((y - self.y0) / self.cell_m).astype(int), np.floor((x - self.x0) / self.cell_m).astype(int)
        inside = ((r >= 0) & (r < len(self.ratio)))[:, None] & ((c >= 0) & (c < self.ratio.shape[1]))[None, :]
        at = np.ix_(np.clip(r, 0, len(self.ratio) - 1), np.clip(c, 0, self.ratio.shape[1] - 1))
        return (
            np.where(inside, self.ratio[at], np.float32(np.nan)),
            np.where(inside, self.sources[at], 0).astype(np.int32),
            inside & self.conflict[at],
        )


def find_conflicts(grid_map: GridMap, evidence: Evidence) -> ConflictView:
    """Compare the sources of a map's evidence with one another, cell by cell.

    Each source gives one value a cell, the mean of its differences to the map there (so that the field's change within
    the cell does not count); its offset to the other sources, over all cells that they share, is taken out first. What
    a source errs by is alike over a cell, so its samples there are one witness. Its noise is what sources of this
    level usually differ by, but no more than the map's ``noise_sd``. The witnesses' weighted variance about their mean,
    in units of that noise, is chi-squared over its degrees of freedom where they agree.

    Parameters
    ----------
    grid_map : GridMap
    evidence : Evidence
        Rows of weight 0 are left out: they are not in the map.

    Raises
    ------
    InputError
        Evidence of other features than the map's.
    """
    if evidence.features is not grid_map.features:
        raise InputError("evidence", f"is of {evidence.features.value}, the map of {grid_map.features.value}")
    used = evidence.subset(evidence.weight > 0.0)
    rows, columns = (int(np.ceil(n * grid_map.cell_m / CONFLICT_CELL_M)) for n in grid_map.shape)
    shape = (rows, columns)
    corner = (grid_map.x0 - 0.5 * grid_map.cell_m, grid_map.y0 - 0.5 * grid_map.cell_m)
    cell, source, values, spread = _witnesses(grid_map, used, corner, shape)
    values = values - _offsets(cell, source, values, len(used.sources))[source]
    variance = _usual(cell, values, np.array(grid_map.noise_sd)) + spread
    ratio, count = _between(cell, values, 1.0 / variance, shape[0] * shape[1])
    ratio = ratio.mean(axis=1)
    freedom = np.maximum(count - 1, 1) * values.shape[1]
    limit = stats.chi2.ppf(1.0 - LEVEL_OF_CONFLICT, freedom) / freedom
    return ConflictView(
        *corner,
        CONFLICT_CELL_M,
        count.reshape(shape).astype(np.int32),
        np.where(count > 1, ratio, np.nan).reshape(shape).astype(np.float32),
        limit.reshape(shape).astype(np.float32),
    )


def _witnesses(
    grid_map: GridMap, evidence: Evidence, corner: tuple[float, float], shape: tuple[int, int]
) -> tuple[IntArray, IntArray, Float64Array, Float64Array]:
    """Cell, source, mean difference to the map (n, channels) and variance by position (n, channels), one a visit."""
    xy = evidence.xy.astype(np.float64)
    row, column, inside = nearest_nodes(grid_map, xy)
    row, column, xy = row[inside], column[inside], xy[inside]
    at = [(xy[:, 1] - grid_map.y0) / grid_map.cell_m, (xy[:, 0] - grid_map.x0) / grid_map.cell_m]
    there = np.stack([ndimage.map_coordinates(m, at, order=1, mode="nearest") for m in grid_map.mean], axis=1)
    difference = evidence.values[inside].astype(np.float64) - there
    slope = np.stack([np.hypot(*np.gradient(m, grid_map.cell_m))[row, column] for m in grid_map.mean], axis=1)
    by_place = (evidence.spread[inside, None].astype(np.float64) * slope) ** 2
    cell = _index(xy, corner, shape)
    _, first, visit = np.unique(
        cell * len(evidence.sources) + evidence.source[inside], return_index=True, return_inverse=True
    )
    size = np.bincount(visit)[:, None]
    return (
        cell[first],
        evidence.source[inside][first].astype(np.int64),
        _sums(visit, difference) / size,
        _sums(visit, by_place) / size,
    )


def _index(xy: Float64Array, corner: tuple[float, float], shape: tuple[int, int]) -> IntArray:
    r = np.clip(((xy[:, 1] - corner[1]) / CONFLICT_CELL_M).astype(np.int64), 0, shape[0] - 1)
    c = np.clip(((xy[:, 0] - corner[0]) / CONFLICT_CELL_M).astype(np.int64), 0, shape[1] - 1)
    index: IntArray = r * shape[1] + c
    return index


def _sums(index: IntArray, values: Float64Array, size: int = 0) -> Float64Array:
    return np.stack([np.bincount(index, weights=v, minlength=size) for v in values.T], axis=1)


def _offsets(cell: IntArray, source: IntArray, values: Float64Array, n: int) -> Float64Array:
    """What each source differs from the others by where they meet, (n, channels): medians, so that places where one of
    them is wrong do not spread over its walk."""
    offsets = np.zeros((n, values.shape[1]))
    _, place = np.unique(cell, return_inverse=True)
    count = np.bincount(place)
    for _ in range(_ROUNDS):
        left = values - offsets[source]
        others = (_sums(place, left)[place] - left) / np.maximum(count[place] - 1, 1)[:, None]
        for k in range(n):
            mine = (source == k) & (count[place] > 1)
            if mine.sum() >= _OFFSET_CELLS:
                # half the way: two sources that meet only each other would swap their offset for ever
                offsets[k] += 0.5 * np.median(left[mine] - others[mine], axis=0)
    return offsets


def _usual(cell: IntArray, values: Float64Array, noise_sd: Float64Array) -> Float64Array:
    """Variance of a witness, (channels,): the mean over shared cells, whose largest twentieth is cut to the rest."""
    _, place = np.unique(cell, return_inverse=True)
    between, count = _between(place, values, np.ones_like(values), int(place.max(initial=0)) + 1)
    most = noise_sd**2
    if (count > 1).any():
        shared = between[count > 1]
        cut = np.minimum(shared, np.percentile(shared, 95, axis=0))
        most = np.minimum(most, (cut * (count[count > 1, None] - 1)).sum(axis=0) / (count[count > 1] - 1).sum())
    variance: Float64Array = np.maximum(most, _LEAST_NOISE_UT**2)
    return variance


def _between(cell: IntArray, values: Float64Array, weight: Float64Array, cells: int) -> tuple[Float64Array, IntArray]:
    """Weighted variance between each cell's sources, (cells, channels), and their number."""
    count = np.bincount(cell, minlength=cells)
    total = np.maximum(_sums(cell, weight, cells), 1e-12)
    mean = _sums(cell, weight * values, cells) / total
    square = _sums(cell, weight * (values - mean[cell]) ** 2, cells)
    return square / np.maximum(count - 1, 1)[:, None], count
