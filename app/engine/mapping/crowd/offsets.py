"""Hard iron and turn of a session against the map it was located on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from app.engine.mapping.builder import to_features
from app.engine.mapping.crowd.lookup import FieldThere, read_field
from app.engine.mapping.offsets import rotate_horizontal
from app.engine.mapping.samples import PlacedSamples
from app.engine.types import DeviceCalibration, FeatureSet, Float64Array, GridMap

_ITERATIONS = 4
_FREEDOM = 4.0
"""Degrees of freedom of the Student t that rows are compared by: a passing trolley must not turn a session."""
_ALIKE = 6.0
"""Rows (two a step) that err together: the walk's own error is correlated over about two metres."""
_GRADIENT_PER_M = 0.5
"""Change of the field over a metre, in units of the deviation of a reading about the map: what a wrong place costs."""


@dataclass(frozen=True, slots=True)
class OffsetPrior:
    """What is known of a session before it is compared: hard iron (uT: forward, left, up) and its deviation, and how
    far the direction of motion is trusted to be that of the device, rad."""

    hard_iron: Float64Array
    hard_iron_sd: Float64Array
    turn_sd: float = 0.2

    @classmethod
    def of(cls, known: DeviceCalibration) -> OffsetPrior:
        """From what is known of a device."""
        return cls(np.array(known.offset), np.array(known.offset_sd))


@dataclass(frozen=True, slots=True)
class SessionOffset:
    """Hard iron (uT: forward, left, up) and turn from the direction of motion to the device (rad), with deviations."""

    hard_iron: tuple[float, float, float]
    turn: float
    hard_iron_sd: tuple[float, float, float]
    turn_sd: float

    def field(self, placed: PlacedSamples) -> Float64Array:
        """Corrected field in the level frame, shape (n, 3), uT."""
        return rotate_horizontal(placed.mag - np.array(self.hard_iron), placed.heading + self.turn)


def fit_offset(placed: PlacedSamples, grid_map: GridMap, prior: OffsetPrior, spread: Float64Array) -> SessionOffset:
    """Robust least squares of a session's field against the map's, with priors on what is sought (Gauss-Newton).

    Parameters
    ----------
    placed : PlacedSamples
    grid_map : GridMap
    prior : OffsetPrior
    spread : array, shape (n,), m
        Of the places: a row that may lie elsewhere is compared with what may be read there.
    """
    there = read_field(grid_map, placed.xy)
    noise = np.array(grid_map.noise_sd)
    variance = there.sd**2 + noise**2 * (1.0 + (_GRADIENT_PER_M * spread[:, None]) ** 2)
    if grid_map.features is not FeatureSet.VECTOR:
        return _without_turn(prior)
    mean, cov = np.append(prior.hard_iron, 0.0), np.diag(np.append(prior.hard_iron_sd, prior.turn_sd) ** 2)
    information = np.linalg.inv(cov)
    state = mean
    for _ in range(_ITERATIONS):
        residual, jacobian = _linearized(placed, there, state)
        square = (residual**2 / variance).sum(axis=1)
        robust = (_FREEDOM + 3.0) / (_FREEDOM + square)
        weight = robust[:, None] * there.mapped[:, None] / (_ALIKE * variance)
        normal = information + np.einsum("nci,nc,ncj->ij", jacobian, weight, jacobian)
        right = np.einsum("nci,nc->i", jacobian, weight * residual) + information @ (mean - state)
        state = state + np.linalg.solve(normal, right)
    sd = np.sqrt(np.diag(np.linalg.inv(normal))).tolist()
    f, left, up, turn = state.tolist()
    return SessionOffset((f, left, up), turn, (sd[0], sd[1], sd[2]), sd[3])


def _without_turn(prior: OffsetPrior) -> SessionOffset:
    """Where the map knows no direction, what is known of the device is all that is taken off."""
    f, left, up = prior.hard_iron.tolist()
    sf, sl, su = prior.hard_iron_sd.tolist()
    return SessionOffset((f, left, up), 0.0, (sf, sl, su), prior.turn_sd)


def _linearized(placed: PlacedSamples, there: FieldThere, state: Float64Array) -> tuple[Float64Array, Float64Array]:
    """Residual map - session (n, 3) and the session's field by (hard iron, turn), shape (n, 3, 4)."""
    heading = placed.heading + state[3]
    field = to_features(rotate_horizontal(placed.mag - state[:3], heading), FeatureSet.VECTOR)
    c, s, nought = np.cos(heading), np.sin(heading), np.zeros(len(heading))
    by_iron = -np.stack(
        [np.stack([c, -s, nought], axis=1), np.stack([s, c, nought], axis=1), np.tile([0.0, 0.0, 1.0], (len(c), 1))],
        axis=1,
    )
    by_turn = np.stack([-field[:, 1], field[:, 0], nought], axis=1)
    return there.mean - field, np.concatenate([by_iron, by_turn[:, :, None]], axis=2)
