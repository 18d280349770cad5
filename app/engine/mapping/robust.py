"""Walks with gross errors: found by what the other walks say of the same cells, and given little weight.

A wrong waypoint puts half a walk where it never was; a steel trolley adds its field to a whole one. In a least squares
estimate such a walk bends the map and its neighbours' offsets. Here the estimate is repeated with weights of a Student
t (Lange, Little and Taylor 1989, doi:10.2307/2290063, section 2) of each walk as a whole, squared.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from app.engine.mapping.offsets import WalkOffsets, cells_of, estimate_offsets
from app.engine.mapping.samples import PlacedSamples
from app.engine.types import BoolArray, Float64Array, IntArray

TOLERATED = 16.0
"""Mean square of a walk's normalized misfit up to which it has full weight. Not less: where the field is steep every
walk misfits, and a map of left-out walks gets worse when such places lose weight (1 to 17 % on three mall floors)."""
DEGREES_OF_FREEDOM = 1.0
"""Of the Student t beyond: of a walk's dozens of samples far fewer are independent."""
LEAST_WEIGHT = 0.01
_LEAST_SCALE = 1.0
"""uT; what phones do not repeat, however well walks agree."""
_TO_SIGMA = 1.4826
_ROUNDS = 3
_LEAST_SHARED = 10
"""Samples of a walk in cells of others, below which nothing can be said against it."""


def estimate_robustly(walks: Sequence[PlacedSamples]) -> tuple[WalkOffsets, Float64Array]:
    """Offsets of all walks, and the weight of every sample, shape (n,), one walk after the other, 0.01 to 1."""
    n = sum(len(walk) for walk in walks)
    weight = np.ones(n)
    offsets = estimate_offsets(walks)
    for _ in range(_ROUNDS):
        weight = sample_weights(walks, offsets, weight)
        offsets = estimate_offsets(walks, weight)
    return offsets, weight


def sample_weights(walks: Sequence[PlacedSamples], offsets: WalkOffsets, weight: Float64Array) -> Float64Array:
    """Weight of each sample: its walk's, by the distance from the mean of the *other* walks in each cell.

    Parameters
    ----------
    walks : sequence of PlacedSamples
    offsets : WalkOffsets
    weight : array, shape (n,)
        Of the round before: others count by it.
    """
    owner = np.concatenate([np.full(len(walk), i) for i, walk in enumerate(walks)])
    field = np.concatenate([offsets.field(i, walk) for i, walk in enumerate(walks)])
    misfit, shared = _misfit(cells_of(np.concatenate([walk.xy for walk in walks])), owner, field, weight)
    if not shared.any():
        return np.ones(len(owner))
    # the median does not see the walks that are sought
    scale = np.maximum(_TO_SIGMA * np.median(np.abs(misfit[shared]), axis=0), _LEAST_SCALE)
    square = np.where(shared, ((misfit / scale) ** 2).mean(axis=1), 0.0)
    count = np.bincount(owner, shared)
    of_walk = np.bincount(owner, square) / np.maximum(count, 1.0)
    suspect = (count >= _LEAST_SHARED) & (of_walk > TOLERATED)
    whole = np.where(suspect, ((DEGREES_OF_FREEDOM + 1.0) / (DEGREES_OF_FREEDOM + of_walk)) ** 2, 1.0)
    return np.asarray(np.maximum(whole, LEAST_WEIGHT)[owner])


def _misfit(
    cell: IntArray, owner: IntArray, field: Float64Array, weight: Float64Array
) -> tuple[Float64Array, BoolArray]:
    """Field less the weighted mean of other walks in the cell, (n, 3), and where there are others, (n,)."""
    pair, of_pair = np.unique(cell * (owner.max() + 1) + owner, return_inverse=True)
    of_pair = of_pair.reshape(-1)
    in_cell = np.bincount(cell, weight)[cell] - np.bincount(of_pair, weight, minlength=len(pair))[of_pair]
    shared = in_cell > 1e-9
    misfit = np.zeros(field.shape)
    for c in range(field.shape[1]):
        heavy = weight * field[:, c]
        others = np.bincount(cell, heavy)[cell] - np.bincount(of_pair, heavy, minlength=len(pair))[of_pair]
        misfit[:, c] = np.where(shared, field[:, c] - others / np.where(shared, in_cell, 1.0), 0.0)
    return misfit, shared
