"""What an iterative closest contour search draws the points of a track to."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from app.engine.matching.contours import ContourMap
from app.engine.matching.field import read_map
from app.engine.types import Float64Array

_LEVELS = np.array([-1.5, -0.75, 0.0, 0.75, 1.5])
_VECTOR_STEPS = 5


@dataclass(frozen=True, slots=True)
class Pull:
    """Targets of the points, one for each channel or one for all.

    Attributes
    ----------
    targets : array, shape (n, k, 2), m, level frame
    weights : array, shape (n, k)
        0 where nothing was found.
    """

    targets: Float64Array
    weights: Float64Array


Correspondence = Callable[[ContourMap, Float64Array, Float64Array, Float64Array, float], Pull]
"""``(contours, points, values, sd, radius_m)``: points (n, 2), m; values and sd (n, channels), uT."""


def nearest_contours(
    contours: ContourMap, points: Float64Array, values: Float64Array, sd: Float64Array, radius_m: float
) -> Pull:
    """The nearest point of the contour of each channel's value."""
    targets, weights = np.empty((*values.shape, 2)), np.empty(values.shape)
    for c in range(values.shape[1]):
        near = contours.nearest(c, points, values[:, c], radius_m)
        targets[:, c], weights[:, c] = near.xy, near.found * _sharpness(contours, near.gradient, sd[:, c])
    return Pull(targets, weights)


def associated_contours(
    contours: ContourMap, points: Float64Array, values: Float64Array, sd: Float64Array, radius_m: float
) -> Pull:
    """Several pseudo-measurements within the noise, fused by probabilistic data association.

    The nearest points of the contours of some values about the reading, each as probable as its value is as the true
    one and as its distance is among those of all points; what is found for a point counts by their sum against the
    probability that none is right (a quarter of that of a perfect one).
    """
    targets, weights = np.empty((*values.shape, 2)), np.empty(values.shape)
    for c in range(values.shape[1]):
        near = [contours.nearest(c, points, values[:, c] + level * sd[:, c], radius_m) for level in _LEVELS]
        distance = np.stack([one.distance for one in near])
        nearest = distance.min(axis=0)
        met = np.isfinite(nearest)
        spread = max(float(np.sqrt((nearest[met] ** 2).mean())) if met.any() else 0.0, 0.3 * contours.grid_map.cell_m)
        beta = np.exp(-0.5 * (_LEVELS[:, None] ** 2 + (distance / spread) ** 2))
        total = beta.sum(axis=0)
        share = beta / np.maximum(total, 1e-12)
        targets[:, c] = np.einsum("ln,lnd->nd", share, np.stack([one.xy for one in near]))
        gradient = np.einsum("ln,lnd->nd", share, np.stack([one.gradient for one in near]))
        targets[total <= 1e-12, c] = points[total <= 1e-12]
        weights[:, c] = total / (total + 0.25) * _sharpness(contours, gradient, sd[:, c]) * (total > 1e-12)
    return Pull(targets, weights)


def nearest_vectors(
    contours: ContourMap, points: Float64Array, values: Float64Array, sd: Float64Array, radius_m: float
) -> Pull:
    """The point that is nearest both in place and in all components.

    It minimizes ``|x - p|^2 / radius^2 + sum (m(x) - z)^2 / sd^2`` by damped Gauss-Newton steps of at most a cell: two
    components already tell a point, of which a single contour only tells a line.
    """
    cell = contours.grid_map.cell_m
    x = points.copy()
    for _ in range(_VECTOR_STEPS):
        reading = read_map(contours.grid_map, contours.features, x[:, 0], x[:, 1])
        g = reading.gradient / sd[:, :, None]
        r = (values - reading.mean) / sd
        information = np.einsum("nci,ncj->nij", g, g) + np.eye(2) / radius_m**2
        step = np.linalg.solve(information, (np.einsum("nci,nc->ni", g, r) + (points - x) / radius_m**2)[:, :, None])
        length = np.hypot(step[:, 0, 0], step[:, 1, 0])
        x = x + step[:, :, 0] / np.maximum(length / cell, 1.0)[:, None]
    reading = read_map(contours.grid_map, contours.features, x[:, 0], x[:, 1])
    misfit = (((values - reading.mean) / sd) ** 2).mean(axis=1)
    near = reading.mapped & (np.hypot(*(x - points).T) <= radius_m)
    return Pull(x[:, None], (near / (1.0 + misfit))[:, None])


def _sharpness(contours: ContourMap, gradient: Float64Array, sd: Float64Array) -> Float64Array:
    """Weight of a contour's point by how well the reading places the contour, between 0 and 1, a half at one cell."""
    slope = (gradient**2).sum(axis=1) * contours.grid_map.cell_m**2
    weight: Float64Array = slope / (slope + sd**2)
    return weight
