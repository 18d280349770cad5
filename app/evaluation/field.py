"""How well maps predict the field where walks that they have not seen pass, and how true their claimed deviation is.

>>> from pathlib import Path
>>> from app.evaluation.field import FieldOptions, run_field
>>> print(run_field(FieldOptions(Path("data"))).table())  # doctest: +SKIP
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from scipy.ndimage import map_coordinates
from scipy.spatial import cKDTree

from app.engine.errors import InputError
from app.engine.mapping import build_map
from app.engine.mapping.offsets import offsets_on_map
from app.engine.mapping.samples import PlacedSamples, place_samples
from app.engine.types import Float64Array, GridMap, IntArray, MapBuild, Progress
from app.evaluation.datasets.ilc20 import Ilc20Level, Split, open_ilc20
from app.evaluation.tables import layout

CELL_M = 0.5
"""Of the baseline: the mean of the survey's readings in each cell."""
DISTANCES_M = (0.0, 0.5, 1.0, 2.0, 4.0)
"""Edges of the classes of distance to the nearest survey sample."""
CHANNELS = ("x", "y", "z")


@dataclass(frozen=True, slots=True)
class FieldOptions:
    """What to evaluate: folder that holds ``ilc20/``, and names of levels (empty: all that are found)."""

    data: Path
    levels: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class FieldScores:
    """Residuals of a level's test walks; rows of one walk follow each other.

    Attributes
    ----------
    level : str
    ours, baseline : arrays, shape (n, 2), uT
        Vertical and horizontal magnitude of the reading less the prediction's, the walk's mean difference removed;
        only rows whose cell holds a survey sample.
    normalized : array, shape (m, 3)
        Vector of the reading, the walk's hard iron and carrying angle removed, less the map's, over the claimed
        deviation (of map and reading together).
    distance : array, shape (m,), m
        To the nearest survey sample.
    """

    level: str
    ours: Float64Array
    baseline: Float64Array
    normalized: Float64Array
    distance: Float64Array

    def values(self) -> dict[str, Any]:
        """Plain values for JSON; null where there is nothing to score."""
        return {
            "n": len(self.ours),
            "rms_vertical": _rms(self.ours[:, 0]),
            "rms_horizontal": _rms(self.ours[:, 1]),
            "baseline_vertical": _rms(self.baseline[:, 0]),
            "baseline_horizontal": _rms(self.baseline[:, 1]),
            "normalized_variance": self._variance(0.0, DISTANCES_M[-1]),
            "by_distance": [
                {"from_m": low, "to_m": high, **self._variance(low, high)} for low, high in pairwise(DISTANCES_M)
            ],
        }

    def _variance(self, low: float, high: float) -> dict[str, Any]:
        rows = (self.distance >= low) & (self.distance < high)
        square = self.normalized[rows] ** 2
        if not len(square):
            return {"n": 0, "all": None, **dict.fromkeys(CHANNELS)}
        channels = {name: float(v) for name, v in zip(CHANNELS, square.mean(axis=0), strict=True)}
        return {"n": len(square), "all": float(square.mean()), **channels}


@dataclass(frozen=True, slots=True)
class FieldReport:
    """Scores of all levels, and pooled."""

    levels: tuple[FieldScores, ...]

    @property
    def overall(self) -> FieldScores:
        """All levels as one."""
        parts = {
            name: np.concatenate([getattr(level, name) for level in self.levels])
            for name in ("ours", "baseline", "normalized", "distance")
        }
        return FieldScores("all", **parts)

    def to_json(self) -> str:
        """The report as JSON text."""
        levels = {level.level: level.values() for level in self.levels}
        return json.dumps({"set": "ilc20", "task": "field", "levels": levels, "overall": self.overall.values()})

    def table(self) -> str:
        """The report as text."""
        by_distance = (f"{low:g}-{high:g} m" for low, high in pairwise(DISTANCES_M))
        columns = ("level", "n", "Bv base", "ours", "gain", "Bh base", "ours", "gain", "variance x", "y", "z")
        header = (*columns, *by_distance)
        rows = [header, *(_row(level) for level in (*self.levels, self.overall))]
        return "\n".join(
            [
                "Field at test steps in surveyed cells, rms in uT (Bv vertical, Bh horizontal magnitude); base: mean",
                "of each 0.5 m cell. Variance: residual squared over claimed variance, 1 is true; by distance to the",
                "nearest survey sample.",
                "",
                *layout(rows, left=1),
            ]
        )


def _row(scores: FieldScores) -> tuple[str, ...]:
    v = scores.values()
    cells = [scores.level, str(v["n"])]
    for part in ("vertical", "horizontal"):
        base, ours = v[f"baseline_{part}"], v[f"rms_{part}"]
        cells += [_cell(base), _cell(ours), "-" if base is None else f"{100 * (1 - ours / base):.0f} %"]
    cells += [_cell(v["normalized_variance"][name]) for name in CHANNELS]
    return (*cells, *(_cell(one["all"]) for one in v["by_distance"]))


def _cell(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"


def _rms(residual: Float64Array) -> float | None:
    return float(np.sqrt((residual**2).mean())) if len(residual) else None


def run_field(options: FieldOptions, progress: Progress | None = None) -> FieldReport:
    """Build the map of each level from its train walks and predict the field along its test walks.

    Raises
    ------
    DataSetError
        The data are not there or not in the format.
    MapError
        A level has no map.
    """
    data = open_ilc20(options.data)
    names = options.levels or data.levels()
    scores = []
    for i, name in enumerate(names):
        if progress is not None:
            progress(i / len(names), name)
        scores.append(score_level(data.level(name)))
    return FieldReport(tuple(scores))


def score_level(level: Ilc20Level) -> FieldScores:
    """Scores of one level: map from its train walks, residuals of its test walks."""
    # radio layers and the floor plan do not touch the field
    train = [replace(walk.survey_walk(), wifi=None, ble=None) for walk in level.walks("train")]
    build = build_map(level.name, train)
    return score_walks(level.name, build, _placed(level, "train"), _placed(level, "test"))


def _placed(level: Ilc20Level, split: Split) -> list[PlacedSamples]:
    walks = []
    for walk in level.walks(split):
        with contextlib.suppress(InputError):  # too few steps or labels: neither survey nor truth
            walks.append(place_samples(walk.survey_walk()))
    return walks


def score_walks(
    level: str, build: MapBuild, survey: Sequence[PlacedSamples], walks: Sequence[PlacedSamples]
) -> FieldScores:
    """Residuals of ``walks`` against a map and against the cell means of the survey it was built from."""
    cells, tree = CellMeans.of(survey), cKDTree(build.evidence.xy)
    grid, noise = build.grid_map, np.asarray(build.grid_map.noise_sd)
    ours, baseline, normalized, distance = [], [], [], []
    for walk in walks:
        mean, sd = predicted(grid, walk.xy)
        away = np.asarray(tree.query(walk.xy)[0], dtype=np.float64)
        variance = sd**2 + noise**2
        seen = np.flatnonzero(away < DISTANCES_M[-1])
        if not len(seen):
            continue
        part = walk.subset(seen)
        offsets = offsets_on_map(part, mean[seen], variance[seen])
        field = offsets.field(part)
        normalized.append((field - mean[seen]) / np.sqrt(variance[seen]))
        distance.append(away[seen])
        reading, expected = magnitudes(walk.mag), cells.at(walk.xy)
        known = np.isfinite(expected).all(axis=1)
        if known.any():
            ours.append(_centred((reading - magnitudes(mean))[known]))
            baseline.append(_centred((reading - expected)[known]))
    none = np.empty((0, 2))
    return FieldScores(
        level,
        np.concatenate([none, *ours]),
        np.concatenate([none, *baseline]),
        np.concatenate([np.empty((0, 3)), *normalized]),
        np.concatenate([np.empty(0), *distance]),
    )


def predicted(grid: GridMap, xy: Float64Array) -> tuple[Float64Array, Float64Array]:
    """Mean and deviation of the map at places, bilinear between nodes, shape (n, channels) each, uT."""
    at = np.stack([(xy[:, 1] - grid.y0) / grid.cell_m, (xy[:, 0] - grid.x0) / grid.cell_m])
    mean, sd = (
        np.stack([map_coordinates(layer.astype(np.float64), at, order=1, mode="nearest") for layer in layers], axis=1)
        for layers in (grid.mean, grid.sd)
    )
    return mean, sd


def magnitudes(field: Float64Array) -> Float64Array:
    """Vertical and horizontal magnitude, shape (n, 2), uT."""
    return np.stack([field[:, 2], np.hypot(field[:, 0], field[:, 1])], axis=1)


def _centred(residual: Float64Array) -> Float64Array:
    return np.asarray(residual - residual.mean(axis=0))


@dataclass(frozen=True, slots=True, eq=False)
class CellMeans:
    """Mean of the survey's raw magnitudes per cell: ``cells`` (k,) sorted codes, ``mean`` (k, 2) uT."""

    cells: IntArray
    mean: Float64Array

    @classmethod
    def of(cls, survey: Sequence[PlacedSamples]) -> CellMeans:
        """From placed walks, their readings as they are."""
        code = _codes(np.concatenate([walk.xy for walk in survey]))
        cells, owner = np.unique(code, return_inverse=True)
        values = magnitudes(np.concatenate([walk.mag for walk in survey]))
        sums = np.stack([np.bincount(owner, column) for column in values.T], axis=1)
        return cls(cells, sums / np.bincount(owner)[:, None])

    def at(self, xy: Float64Array) -> Float64Array:
        """Mean of the cell of each place, NaN where nobody was, shape (n, 2)."""
        code = _codes(xy)
        row = np.minimum(np.searchsorted(self.cells, code), len(self.cells) - 1)
        return np.where((self.cells[row] == code)[:, None], self.mean[row], np.nan)


def _codes(xy: Float64Array) -> IntArray:
    """One number for each cell of the plane."""
    column, row = np.floor(xy / CELL_M).astype(np.int64).T
    return np.asarray(row * 2**31 + column, dtype=np.int64)
