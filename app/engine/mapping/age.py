"""How old the evidence of a map is, place by place."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from app.engine.mapping.quality import CONFLICT_CELL_M
from app.engine.types import Evidence, Float64Array, GridMap


@dataclass(frozen=True, slots=True, eq=False)
class NewestEvidence:
    """When each cell of a metre was last measured.

    Attributes
    ----------
    x0, y0, cell_m : float, m
        Corner and size of the cells: ``[r, c]`` covers ``x0 + c .. x0 + c + 1`` metres, likewise ``y``.
    t : array, shape (rows, columns), UTC s
        NaN where nothing was measured, or at a time that is not known.
    """

    x0: float
    y0: float
    cell_m: float
    t: Float64Array


def newest_evidence(grid_map: GridMap, evidence: Evidence) -> NewestEvidence:
    """Times of the newest sources that count (rows of weight 0 are not in the map), by cells of a metre."""
    x0, y0 = grid_map.x0 - 0.5 * grid_map.cell_m, grid_map.y0 - 0.5 * grid_map.cell_m
    rows, columns = (int(np.ceil(n * grid_map.cell_m / CONFLICT_CELL_M)) for n in grid_map.shape)
    t = np.array([source.t for source in evidence.sources], dtype=np.float64)[evidence.source]
    r, c = np.floor((evidence.xy[:, ::-1].T.astype(np.float64) - [[y0], [x0]]) / CONFLICT_CELL_M).astype(np.int64)
    counts = (evidence.weight > 0.0) & (t > 0.0) & (r >= 0) & (r < rows) & (c >= 0) & (c < columns)
    newest = np.full((rows, columns), -np.inf)
    np.maximum.at(newest, (r[counts], c[counts]), t[counts])
    return NewestEvidence(x0, y0, CONFLICT_CELL_M, np.where(np.isfinite(newest), newest, np.nan))
