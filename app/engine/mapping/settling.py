"""One survey walk brought into agreement with a map that is there already.

The same unknowns as in a build (hard iron, carrying angle, displacement along and across the way), but of one walk
against a map that stays as it is: a few unknowns, milliseconds.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import map_coordinates

from app.engine.mapping.adjustment import AdjustmentPolicy, OthersMap, displacement
from app.engine.mapping.offsets import rotate_horizontal
from app.engine.mapping.samples import PlacedSamples
from app.engine.types import Float64Array, GridMap

HARD_IRON_SD = 4.0
CARRY_SD = float(np.radians(8.0))
_TEMPER = 0.25
"""Weight of one sample: two a step, and neighbours err together (as in the adjustment of walks)."""
_DEGREES_OF_FREEDOM = 4.0
_ITERATIONS = 6


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
    iron, _, carry = _offsets(walk, others)
    field = rotate_horizontal(walk.mag - iron, walk.heading + carry)
    moved = replace(walk, xy=walk.xy + displacement(walk, field, others, policy or AdjustmentPolicy()))
    iron, sd, carry = _offsets(moved, others)
    return SettledWalk(moved, rotate_horizontal(walk.mag - iron, walk.heading + carry), iron, sd, carry)


def _offsets(walk: PlacedSamples, others: OthersMap) -> tuple[Float64Array, Float64Array, float]:
    """Hard iron (3,), its deviation, and carrying angle: Gauss-Newton with Student t weights and Gaussian priors."""
    at = np.stack([(walk.xy[:, 1] - others.y0) / others.cell_m, (walk.xy[:, 0] - others.x0) / others.cell_m])
    mean, sd = (
        np.stack([map_coordinates(layer[c], at, order=1, mode="nearest") for c in range(3)]) for layer in
        (others.mean, others.sd)
    )  # fmt: skip
    variance = sd**2 + others.noise_sd[:, None] ** 2
    unknown, prior = np.zeros(4), np.array([HARD_IRON_SD**-2] * 3 + [CARRY_SD**-2])
    normal = np.diag(prior)
    for _ in range(_ITERATIONS):
        field = rotate_horizontal(walk.mag - unknown[:3], walk.heading + unknown[3]).T
        residual = mean - field
        squared = (residual**2 / variance).sum(axis=0)
        weight = _TEMPER * (_DEGREES_OF_FREEDOM + 3.0) / (_DEGREES_OF_FREEDOM + squared) / variance
        design = _design(walk.heading + unknown[3], field)
        normal = np.einsum("kni,kn,knj->ij", design, weight, design) + np.diag(prior)
        right = np.einsum("kni,kn,kn->i", design, weight, residual) - prior * unknown
        unknown = unknown + np.linalg.solve(normal, right)
    deviation = np.sqrt(np.diag(np.linalg.inv(normal)))
    return unknown[:3], deviation[:3], float(unknown[3])


def _design(heading: Float64Array, field: Float64Array) -> Float64Array:
    """Derivatives of the field (x, y, z) by hard iron (forward, left, up) and carrying angle, shape (3, n, 4)."""
    design = np.zeros((3, len(heading), 4))
    c, s = np.cos(heading), np.sin(heading)
    design[0, :, 0], design[0, :, 1], design[0, :, 3] = -c, s, -field[1]
    design[1, :, 0], design[1, :, 1], design[1, :, 3] = -s, -c, field[0]
    design[2, :, 2] = -1.0
    return design
