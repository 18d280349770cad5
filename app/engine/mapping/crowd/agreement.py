"""What everybody else says of a cell, and by how much a pass differs from it.

For each pass the cell's and its neighbours' passes are summed up without those of its own witness, and the field at the
pass is kriged from these (simple kriging, Chiles and Delfiner 2012, section 3.2; the cells' means are the data). No
witness confirms itself, and however many passes a cell has, a pass is compared with nine numbers.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from app.engine.mapping.crowd.passes import Passes, find
from app.engine.mapping.model import Covariance
from app.engine.types import BoolArray, Float64Array, IntArray

_CHUNK = 8192
_ALIKE = 2.0
"""The error of a walk is the same in the two or three of the nine cells it passes: their means are not independent."""
_NOBODY = 1e6
_LEAST = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """Of each pass with all other witnesses.

    Attributes
    ----------
    residual : array, shape (p, channels)
        Pass minus others, units of the field's standard deviation.
    variance : array, shape (p,)
        Expected of it per channel.
    explained : array, shape (p,)
        Share of the field's variance that the others explain there: 0 where nobody else was.
    others : array, shape (p,)
        How many witnesses there are, in that of the nine cells that has most.
    surveyed : array, shape (p,), bool
        Whether a survey is among them.
    """

    residual: Float64Array
    variance: Float64Array
    explained: Float64Array
    others: IntArray
    surveyed: BoolArray

    @property
    def misfit(self) -> Float64Array:
        """Mean over channels of the squared residual over its variance, shape (p,): about 1 where all is well."""
        return np.asarray((self.residual**2).mean(axis=1) / self.variance)


@dataclass(frozen=True, slots=True, eq=False)
class _Sums:
    """Sums over groups of passes: information, times position, times value."""

    information: Float64Array
    place: Float64Array
    value: Float64Array

    @classmethod
    def of(cls, passes: Passes, information: Float64Array, group: IntArray, n: int) -> _Sums:
        def summed(columns: Float64Array) -> Float64Array:
            return np.stack([np.bincount(group, information * column, n) for column in columns.T], axis=1)

        return cls(np.bincount(group, information, n).astype(np.float64), summed(passes.xy), summed(passes.value))

    def at(self, index: IntArray) -> tuple[Float64Array, Float64Array, Float64Array]:
        """Rows of an index that may be -1 (nothing)."""
        there = index >= 0
        return (
            np.where(there, self.information[index], 0.0),
            np.where(there[..., None], self.place[index], 0.0),
            np.where(there[..., None], self.value[index], 0.0),
        )


def shared_credit(passes: Passes, credit: Float64Array) -> Float64Array:
    """Credit of each pass such that the passes of one witness over one cell count as one together, shape (p,)."""
    _, group = np.unique(passes.cell * (passes.witness.max(initial=0) + 1) + passes.witness, return_inverse=True)
    in_use = np.bincount(group, credit > 0)
    return credit / np.maximum(in_use[group], 1)


def compare(passes: Passes, covariance: Covariance, credit: Float64Array) -> Comparison:
    """Compare each pass with the others.

    Parameters
    ----------
    passes : Passes
    covariance : Covariance
    credit : array, shape (p,), 0 to 1
        What each pass counts for as a witness.
    """
    p, m = len(passes), len(passes.cells)
    information = shared_credit(passes, credit) / (_ALIKE * passes.noise)
    everybody = _Sums.of(passes, information, passes.cell, m)
    pair = passes.witness * m + passes.cell
    keys, group = np.unique(pair, return_inverse=True)
    own = _Sums.of(passes, information, group, len(keys))
    heard = credit > 0
    surveys, own_surveys = (
        np.bincount(where, passes.survey & heard, n) for where, n in ((passes.cell, m), (group, len(keys)))
    )
    present = np.bincount(group, heard, len(keys)) > 0
    witnesses = np.bincount(keys % m, present, m)
    residual, variance = np.empty_like(passes.value), np.empty(p)
    explained, surveyed, count = np.empty(p), np.zeros(p, dtype=np.bool_), np.zeros(p, dtype=np.int64)
    for start in range(0, p, _CHUNK):
        rows = slice(start, start + _CHUNK)
        near = passes.around[passes.cell[rows]]
        mine = find(keys, np.where(near >= 0, passes.witness[rows, None] * m + near, -1))
        total, ours = everybody.at(near), own.at(mine)
        others = tuple(a - b for a, b in zip(total, ours, strict=True))
        mean, unexplained = _krige(passes.xy[rows], others, covariance)
        residual[rows] = passes.value[rows] - mean
        variance[rows] = unexplained + passes.noise[rows]
        explained[rows] = 1.0 - unexplained
        there = np.where(near >= 0, surveys[near], 0) - np.where(mine >= 0, own_surveys[mine], 0)
        surveyed[rows] = (there > 0).any(axis=1)
        count[rows] = (np.where(near >= 0, witnesses[near], 0) - np.where(mine >= 0, present[mine], 0)).max(axis=1)
    return Comparison(residual, variance, explained, count, surveyed)


def _krige(
    xy: Float64Array, others: tuple[Float64Array, ...], covariance: Covariance
) -> tuple[Float64Array, Float64Array]:
    """Mean (q, channels) and variance (q,) of the field at ``xy`` (q, 2) from nine nodes each."""
    information, place, value = others
    known = information > _LEAST
    divisor = np.where(known, information, 1.0)
    node = np.where(known[..., None], place / divisor[..., None], xy[:, None])
    data = np.where(known[..., None], value / divisor[..., None], 0.0)
    matrix = _correlation(np.linalg.norm(node[:, :, None] - node[:, None], axis=-1), covariance)
    diagonal = np.arange(node.shape[1])
    matrix[:, diagonal, diagonal] += np.where(known, 1.0 / divisor, _NOBODY)
    to_node = _correlation(np.linalg.norm(node - xy[:, None], axis=-1), covariance) * known
    weight = np.linalg.solve(matrix, to_node[..., None])[..., 0]
    return (weight[..., None] * data).sum(axis=1), np.maximum(1.0 - (weight * to_node).sum(axis=1), _LEAST)


def _correlation(d: Float64Array, covariance: Covariance) -> Float64Array:
    """Of the field at two places ``d`` metres apart."""
    coarse, fine = np.sqrt(3.0) * d / covariance.length_m, np.sqrt(3.0) * d / covariance.fine_length_m
    return np.asarray(
        (1.0 - covariance.fine) * (1.0 + coarse) * np.exp(-coarse) + covariance.fine * (1.0 + fine) * np.exp(-fine)
    )
