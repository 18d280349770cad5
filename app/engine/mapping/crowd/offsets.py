"""Hard iron and turn of a session against the map it was located on."""

from __future__ import annotations

import numpy as np

from app.engine.mapping.crowd.lookup import read_field
from app.engine.mapping.offsets import ExpectedOffsets, OffsetsOnMap, offsets_on_map
from app.engine.mapping.samples import PlacedSamples
from app.engine.types import DeviceCalibration, FeatureSet, Float64Array, GridMap

_TURN_SD = 0.2
"""How far the direction of motion is that of the device, rad: phones are not carried straight ahead."""
_FREEDOM = 4.0
"""Degrees of freedom of the Student t that rows are compared by: a passing trolley must not turn a session."""
_ALIKE = 6.0
"""Rows (two a step) that err together: the walk's own error is correlated over about two metres."""
_GRADIENT_PER_M = 0.5
"""Change of the field over a metre, in units of the deviation of a reading about the map: what a wrong place costs."""


def expected_of(known: DeviceCalibration) -> ExpectedOffsets:
    """What is known of a session's offsets from what is known of its device."""
    return ExpectedOffsets(known.offset, known.offset_sd, _TURN_SD)


def fit_offset(
    placed: PlacedSamples, grid_map: GridMap, expected: ExpectedOffsets, spread: Float64Array
) -> OffsetsOnMap:
    """Robust least squares of a session's field against the map's, with priors on what is sought.

    Where the map knows no direction, what is known of the device is all that is taken off.

    Parameters
    ----------
    placed : PlacedSamples
    grid_map : GridMap
    expected : ExpectedOffsets
    spread : array, shape (n,), m
        Of the places: a row that may lie elsewhere is compared with what may be read there.
    """
    if grid_map.features is not FeatureSet.VECTOR:
        iron, iron_sd = np.array(expected.hard_iron), np.array(expected.hard_iron_sd)
        return OffsetsOnMap(iron, iron_sd, 0.0, expected.carry_sd)
    there = read_field(grid_map, placed.xy)
    noise = np.array(grid_map.noise_sd)
    variance = there.sd**2 + noise**2 * (1.0 + (_GRADIENT_PER_M * spread[:, None]) ** 2)
    variance[~there.mapped] = np.inf
    return offsets_on_map(placed, there.mean, variance, expected, degrees_of_freedom=_FREEDOM, witness=_ALIKE)
