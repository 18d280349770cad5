"""One survey walk brought into agreement with a map that is there already.

The same unknowns as in a build (hard iron, carrying angle, displacement along and across the way), but of one walk
against a map that stays as it is: a few unknowns, milliseconds.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import map_coordinates

from app.engine.mapping.adjustment import AdjustmentPolicy, OthersMap, displacement
from app.engine.mapping.offsets import OffsetsOnMap, offsets_on_map, rotate_horizontal
from app.engine.mapping.samples import PlacedSamples
from app.engine.types import Float64Array, GridMap

_DEGREES_OF_FREEDOM = 4.0


@dataclass(frozen=True, slots=True)
class SettledWalk:
    """A walk where the map says it was, and what its device adds to the field.

    Attributes
    ----------
    walk : PlacedSamples
        With its ``xy`` moved.
    field : array, shape (n, 3), uT, level frame
        Offsets taken off.
    hard_iron, hard_iron_sd : arrays, shape (3,), uT
        Forward, left, up.
    carry : float, rad
        Device minus motion.
    """

    walk: PlacedSamples
    field: Float64Array
    hard_iron: Float64Array
    hard_iron_sd: Float64Array
    carry: float


def settle_walk(
    walk: PlacedSamples, grid_map: GridMap, *, align: bool = True, policy: AdjustmentPolicy | None = None
) -> SettledWalk:
    """Hard iron, carrying angle and displacement of a walk against a map of the vector field.

    Parameters
    ----------
    walk : PlacedSamples
        By its labels.
    grid_map : GridMap
        Of the ``vector`` features; where it is not mapped its deviation is that of the level, so it says little there.
    align : bool
        False: the walk's device is calibrated and its labels hold; nothing is estimated.
    """
    nothing = np.zeros(3)
    if not align:
        return SettledWalk(walk, rotate_horizontal(walk.mag, walk.heading), nothing, nothing, 0.0)
    others = OthersMap.of(grid_map)
    field = _offsets(walk, others).field(walk)
    moved = replace(walk, xy=walk.xy + displacement(walk, field, others, policy or AdjustmentPolicy()))
    offsets = _offsets(moved, others)
    return SettledWalk(moved, offsets.field(moved), offsets.hard_iron, offsets.hard_iron_sd, offsets.carry)


def _offsets(walk: PlacedSamples, others: OthersMap) -> OffsetsOnMap:
    at = np.stack([(walk.xy[:, 1] - others.y0) / others.cell_m, (walk.xy[:, 0] - others.x0) / others.cell_m])
    mean, sd = (
        np.stack([map_coordinates(layer[c], at, order=1, mode="nearest") for c in range(3)], axis=1)
        for layer in (others.mean, others.sd)
    )
    return offsets_on_map(walk, mean, sd**2 + others.noise_sd**2, degrees_of_freedom=_DEGREES_OF_FREEDOM)
