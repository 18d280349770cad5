"""One field offset and one carrying angle per survey walk, estimated jointly with the field.

Walks through the same cells must agree. Unknown are the field of each one-metre cell (a random effect), each walk's
hard iron (body frame: it turns with the walker) and the angle between device and direction of motion (it turns the
horizontal field, about 0.5 uT per degree). The cells are eliminated, so what is solved is small and dense: a few
unknowns per walk.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

from app.engine.mapping.samples import PlacedSamples
from app.engine.types import ComplexArray, Float64Array, IntArray

CELL_M = 1.0
_FIELD_SD = 5.0
_NOISE_SD = 3.5
_HARD_IRON_SD = 4.0
_CARRY_SD = float(np.radians(8.0))
_ITERATIONS = 3
_ROBUST_ITERATIONS = 6
SAMPLES_A_WITNESS = 4.0
"""Samples of a walk, two a step, that together say as much as one: they err together along a metre or two."""


@dataclass(frozen=True, slots=True)
class WalkOffsets:
    """Per walk: ``hard_iron`` (walks, 3) uT forward, left, up; ``carry`` (walks,) rad, device minus motion."""

    hard_iron: Float64Array
    carry: Float64Array

    def field(self, index: int, walk: PlacedSamples) -> Float64Array:
        """Corrected field of a walk in the level frame, shape (n, 3), uT."""
        return rotate_horizontal(walk.mag - self.hard_iron[index], walk.heading + self.carry[index])


def no_offsets(n_walks: int) -> WalkOffsets:
    """Offsets of walks that need none."""
    return WalkOffsets(np.zeros((n_walks, 3)), np.zeros(n_walks))


def rotate_horizontal(v_l: Float64Array, heading: Float64Array) -> Float64Array:
    """Forward, left, up to x, y, z of the level frame; ``heading`` (n,) rad of the forward axis."""
    c, s = np.cos(heading), np.sin(heading)
    return np.stack([c * v_l[:, 0] - s * v_l[:, 1], s * v_l[:, 0] + c * v_l[:, 1], v_l[:, 2]], axis=1)


def estimate_offsets(walks: Sequence[PlacedSamples], weight: Float64Array | None = None) -> WalkOffsets:
    """Gauss-Newton over hard iron and carrying angle of all walks (linear but for the angle).

    Parameters
    ----------
    walks : sequence of PlacedSamples
    weight : array, shape (n,), or None
        Of the samples of all walks, one walk after the other; None: one each.
    """
    owner = np.concatenate([np.full(len(w), i) for i, w in enumerate(walks)])
    mag = np.concatenate([w.mag for w in walks])
    heading = np.concatenate([w.heading for w in walks])
    cells = _Cells(np.concatenate([w.xy for w in walks]), np.ones(len(owner)) if weight is None else weight)
    horizontal, carry = _horizontal(cells, owner, mag[:, 0] + 1j * mag[:, 1], heading, len(walks))
    vertical = _vertical(cells, owner, mag[:, 2], len(walks))
    return WalkOffsets(np.stack([horizontal.real, horizontal.imag, vertical], axis=1), carry)


@dataclass(frozen=True, slots=True)
class ExpectedOffsets:
    """What is known of a walk's offsets before it is compared with a map; nothing in particular by default.

    Attributes
    ----------
    hard_iron, hard_iron_sd : tuple of three floats, uT
        Forward, left, up.
    carry_sd : float, rad
        How far the direction of motion is trusted to be the device's.
    """

    hard_iron: tuple[float, float, float] = (0.0, 0.0, 0.0)
    hard_iron_sd: tuple[float, float, float] = (_HARD_IRON_SD, _HARD_IRON_SD, _HARD_IRON_SD)
    carry_sd: float = _CARRY_SD


@dataclass(frozen=True, slots=True)
class OffsetsOnMap:
    """``hard_iron``, ``hard_iron_sd`` (3,) uT forward, left, up; ``carry``, ``carry_sd`` rad, device minus motion."""

    hard_iron: Float64Array
    hard_iron_sd: Float64Array
    carry: float
    carry_sd: float

    def field(self, walk: PlacedSamples) -> Float64Array:
        """Corrected field of a walk in the level frame, shape (n, 3), uT."""
        return rotate_horizontal(walk.mag - self.hard_iron, walk.heading + self.carry)


def offsets_on_map(
    walk: PlacedSamples,
    mean: Float64Array,
    variance: Float64Array,
    expected: ExpectedOffsets | None = None,
    *,
    degrees_of_freedom: float = np.inf,
    witness: float = SAMPLES_A_WITNESS,
) -> OffsetsOnMap:
    """Hard iron and carrying angle of one walk that bring its field nearest to a given map (Gauss-Newton).

    Parameters
    ----------
    walk : PlacedSamples
    mean, variance : arrays, shape (n, 3), uT, uT^2
        Of the map at the walk's samples; the variance with the reading's own, infinite where there is no map.
    expected : ExpectedOffsets or None
        None: as :func:`estimate_offsets` expects them.
    degrees_of_freedom : float
        Of the Student t that samples are compared by (all components of a sample together); infinite: least squares.
    witness : float
        Samples that together say as much as one.
    """
    expected = expected or ExpectedOffsets()
    first = np.array([*expected.hard_iron, 0.0])
    information = np.array([*expected.hard_iron_sd, expected.carry_sd]) ** -2.0
    x, normal = first, np.diag(information)
    robust = np.isfinite(degrees_of_freedom)
    for _ in range(_ROBUST_ITERATIONS if robust else _ITERATIONS):
        field = rotate_horizontal(walk.mag - x[:3], walk.heading + x[3])
        residual, slope = mean - field, _slope(walk.heading + x[3], field)
        precision = 1.0 / (variance * witness)
        if robust:
            square = (residual**2 / variance).sum(axis=1)
            precision = precision * ((degrees_of_freedom + 3.0) / (degrees_of_freedom + square))[:, None]
        normal = np.einsum("nci,nc,ncj->ij", slope, precision, slope) + np.diag(information)
        right = np.einsum("nci,nc,nc->i", slope, precision, residual) + information * (first - x)
        x = x + np.linalg.solve(normal, right)
    sd = np.sqrt(np.diag(np.linalg.inv(normal)))
    return OffsetsOnMap(x[:3], sd[:3], float(x[3]), float(sd[3]))


def _slope(heading: Float64Array, field: Float64Array) -> Float64Array:
    """Derivatives of the field (x, y, z) by hard iron (forward, left, up) and carrying angle, shape (n, 3, 4)."""
    c, s, zero = np.cos(heading), np.sin(heading), np.zeros(len(heading))
    return np.stack(
        [
            np.stack([-c, s, zero, -field[:, 1]], axis=1),
            np.stack([-s, -c, zero, field[:, 0]], axis=1),
            np.stack([zero, zero, zero - 1.0, zero], axis=1),
        ],
        axis=1,
    )


def cells_of(xy: Float64Array) -> IntArray:
    """Number of the one-metre cell of each place, shape (n,), counted from 0 over the cells that occur."""
    _, cell = np.unique(np.floor(xy / CELL_M).astype(np.int64), axis=0, return_inverse=True)
    return cell.reshape(-1)


class _Cells:
    """Normal equations with the cells' random effects eliminated (Woodbury per cell)."""

    def __init__(self, xy: Float64Array, weight: Float64Array) -> None:
        cell = cells_of(xy)
        counts = np.bincount(cell, weight)
        n = xy.shape[0]
        self.weight = weight
        self.sum = csr_array((weight, (cell, np.arange(n))), shape=(counts.shape[0], n))
        self.shrink = _FIELD_SD**2 / (_NOISE_SD**2 + counts * _FIELD_SD**2)

    def normal_equations(self, design: csr_array, data: Float64Array) -> tuple[Float64Array, Float64Array]:
        """``A^T P A`` and ``A^T P d`` where P is the data's precision with cell effects integrated out."""
        design_sums = (self.sum @ design).toarray()
        weighted = self.shrink[:, None] * design_sums
        normal = (design.T @ design.multiply(self.weight[:, None])).toarray() - design_sums.T @ weighted
        right = design.T @ (self.weight * data) - weighted.T @ (self.sum @ data)
        return normal / _NOISE_SD**2, right / _NOISE_SD**2


def _horizontal(
    cells: _Cells, owner: IntArray, mag: ComplexArray, heading: Float64Array, n_walks: int
) -> tuple[ComplexArray, Float64Array]:
    """Complex hard iron (forward + i left) and carrying angle of each walk."""
    n = owner.shape[0]
    rows = np.tile(np.arange(n), 5)
    columns = np.concatenate(
        [owner, n_walks + owner, 2 * n_walks + owner, np.full(n, 3 * n_walks), np.full(n, 3 * n_walks + 1)]
    )
    trust = _trust(cells, owner, n_walks)
    iron: ComplexArray = np.zeros(n_walks, dtype=complex)
    carry: Float64Array = np.zeros(n_walks, dtype=np.float64)
    for _ in range(_ITERATIONS):
        turn = np.exp(1j * (heading + carry[owner]))
        # turning a walk by d changes its field by i d M: the mean field M stands in for each sample's own
        mean = np.average((mag - iron[owner]) * turn, weights=cells.weight)
        values = np.concatenate([turn, 1j * turn, np.full(n, -1j * mean), np.ones(n), np.full(n, 1j)])
        normal = np.zeros((3 * n_walks + 2, 3 * n_walks + 2))
        right = np.zeros(3 * n_walks + 2)
        data = mag * turn
        for part in (np.real, np.imag):
            design = csr_array((part(values), (rows, columns)), shape=(n, 3 * n_walks + 2))
            a, r = cells.normal_equations(design, part(data))
            normal += a
            right += r
        iron_rows = np.arange(2 * n_walks)
        normal[iron_rows, iron_rows] += np.tile(trust, 2) / _HARD_IRON_SD**2
        angles = np.arange(2 * n_walks, 3 * n_walks)
        normal[angles, angles] += trust / _CARRY_SD**2
        right[angles] -= trust * carry / _CARRY_SD**2
        solution: Float64Array = np.linalg.solve(normal, right).astype(np.float64)
        iron = solution[:n_walks] + 1j * solution[n_walks : 2 * n_walks]
        carry += solution[angles]
    return iron, carry


def _trust(cells: _Cells, owner: IntArray, n_walks: int) -> Float64Array:
    """Mean weight of each walk, by which its offsets are expected to be small.

    What all walks have in common is told from the field by that expectation alone: a walk that is wrong must not have
    its say there either.
    """
    count = np.bincount(owner, minlength=n_walks)
    return np.asarray(np.bincount(owner, cells.weight, minlength=n_walks) / np.maximum(count, 1))


def _vertical(cells: _Cells, owner: IntArray, mag: Float64Array, n_walks: int) -> Float64Array:
    n = owner.shape[0]
    columns = np.concatenate([owner, np.full(n, n_walks)])
    design = csr_array((np.ones(2 * n), (np.tile(np.arange(n), 2), columns)), shape=(n, n_walks + 1))
    normal, right = cells.normal_equations(design, mag)
    iron_rows = np.arange(n_walks)
    normal[iron_rows, iron_rows] += _trust(cells, owner, n_walks) / _HARD_IRON_SD**2
    solution: Float64Array = np.linalg.solve(normal, right).astype(np.float64)[:n_walks]
    return solution
