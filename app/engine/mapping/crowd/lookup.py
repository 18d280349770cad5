"""A map's field at places between its nodes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import map_coordinates

from app.engine.types import BoolArray, Float64Array, GridMap


@dataclass(frozen=True, slots=True, eq=False)
class FieldThere:
    """Field at n places: ``mean`` and ``sd`` of the map, shape (n, channels), uT; ``mapped``, shape (n,)."""

    mean: Float64Array
    sd: Float64Array
    mapped: BoolArray


def read_field(grid_map: GridMap, xy: Float64Array) -> FieldThere:
    """Field at ``xy``, shape (n, 2), m, level frame: bilinear between nodes; beyond the grid nothing is mapped."""
    rows, columns = grid_map.shape
    c, r = (xy[:, 0] - grid_map.x0) / grid_map.cell_m, (xy[:, 1] - grid_map.y0) / grid_map.cell_m
    at = np.stack([r, c])
    mean, sd = (
        np.stack([map_coordinates(layer, at, order=1, mode="nearest", output=np.float64) for layer in layers], axis=1)
        for layers in (grid_map.mean, grid_map.sd)
    )
    inside = (r >= 0) & (r <= rows - 1) & (c >= 0) & (c <= columns - 1)
    nearest = grid_map.support[
        np.clip(np.rint(r), 0, rows - 1).astype(np.intp), np.clip(np.rint(c), 0, columns - 1).astype(np.intp)
    ]
    return FieldThere(mean, sd, inside & (nearest <= grid_map.mapped_m))
