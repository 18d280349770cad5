"""Expected strength of transmitters over a level: a log-distance trend and a Gaussian process about it.

The trend says what a reading far from the survey is expected to be, the process what walls and furniture change near
it, and its variance how much the survey leaves open (Ferris, Haehnel and Fox, "Gaussian processes for signal
strength-based location estimation", RSS 2006, doi:10.15607/RSS.2006.II.039; there with a constant mean).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.interpolate import RegularGridInterpolator
from scipy.linalg.lapack import strtri

from app.engine.types import Float32Array, Float64Array, IntArray

_NEAREST_M = 2.0
"""Nobody is nearer to an antenna than this: it hangs from the ceiling."""
_MAX_CANDIDATES = 4000
_Z2_CAP = 25.0


@dataclass(frozen=True, slots=True)
class StrengthModel:
    """Parameters of the strength field, fitted on left-out walks.

    Attributes
    ----------
    field_var, length_m : float, dB^2 and m
        Variance and exponential length of the process about the trend.
    walk_var : float, dB^2
        What a walk differs by from another at the same place: how the phone is held, who stands about, the access
        point's own power control.
    reading_var : float, dB^2
        Scatter of readings within a walk.
    power, power_sd : float, dBm
        Prior of the strength at 1 m.
    decay, decay_sd : float
        Prior of the path-loss exponent.
    cell_m : float, m
        Readings in a cell of this size are averaged.
    moves : float
        Left-out cells whose squared standardized residual is larger than this on average: the transmitter does not
        stay where it is, and is dropped.
    """

    field_var: float = 40.0
    length_m: float = 10.0
    walk_var: float = 10.0
    reading_var: float = 15.0
    power: float = -40.0
    power_sd: float = 10.0
    decay: float = 2.5
    decay_sd: float = 1.0
    cell_m: float = 4.0
    candidates_m: float = 6.0
    reach_m: float = 25.0
    moves: float = 4.0

    @property
    def noise(self) -> float:
        """Variance of one reading about the field, dB^2."""
        return self.walk_var + self.reading_var


@dataclass(frozen=True, slots=True)
class CellReadings:
    """Mean readings of each transmitter in each cell.

    Attributes
    ----------
    xy : array, shape (cells, 2), m
        Mean position of all readings in the cell.
    first : array, shape (transmitters + 1,)
        Entries of transmitter ``i`` are ``first[i]:first[i + 1]``.
    cell : array, shape (entries,)
    mean : array, shape (entries,), dBm
    noise : array, shape (entries,), dB^2
        Variance of ``mean`` about the field.
    """

    xy: Float64Array
    first: IntArray
    cell: IntArray
    mean: Float64Array
    noise: Float64Array

    @classmethod
    def of(
        cls, xy: Float64Array, rssi: Float64Array, walk: IntArray, transmitter: IntArray, model: StrengthModel
    ) -> CellReadings:
        """Average readings: ``xy`` (n, 2) m, ``rssi`` (n,) dBm, ``walk`` and ``transmitter`` (n,) numbers from 0."""
        corner = np.floor(xy / model.cell_m).astype(np.int64)
        _, cell = np.unique(corner, axis=0, return_inverse=True)
        cell = cell.ravel()
        n = np.bincount(cell)
        centre = np.stack([np.bincount(cell, xy[:, axis]) / n for axis in (0, 1)], axis=1)
        entry, row = np.unique(transmitter * len(n) + cell, return_inverse=True)
        row = row.ravel()
        count = np.bincount(row)
        by_walk = np.unique(np.stack([row, walk], axis=1), axis=0)[:, 0]
        walks = np.bincount(by_walk, minlength=len(entry))
        owner = entry // len(n)
        first = np.searchsorted(owner, np.arange(int(transmitter.max()) + 2))
        noise = model.walk_var / walks + model.reading_var / count
        return cls(centre, first, entry % len(n), np.bincount(row, rssi) / count, noise)

    @property
    def n_transmitters(self) -> int:
        """Number of transmitters."""
        return len(self.first) - 1

    def dense(self, values: Float64Array) -> Float32Array:
        """Values of the entries as a matrix (cells, transmitters), 0 where there is none."""
        shape = (self.n_transmitters, self.xy.shape[0])
        filled = sparse.csr_matrix((values, self.cell, self.first), shape=shape).toarray()
        return filled.T.astype(np.float32)


@dataclass(frozen=True, slots=True)
class Trend:
    """Log-distance law of each transmitter: ``power - 10 decay log10(distance)``, dBm; ``at`` (n, 2) m."""

    at: Float64Array
    power: Float64Array
    decay: Float64Array

    def strength(self, i: int, xy: Float64Array) -> Float64Array:
        """Strength of transmitter ``i`` at ``xy`` (m, 2), dBm."""
        strength: Float64Array = self.power[i] - self.decay[i] * _log_distance(self.at[i : i + 1], xy)[0]
        return strength


@dataclass(frozen=True, slots=True)
class Strength:
    """Mean and standard deviation of a reading, shape (kept, nodes), dBm and dB; ``kept`` (k,) transmitters."""

    kept: IntArray
    mean: Float32Array
    sd: Float32Array


def _log_distance(a: Float64Array, b: Float64Array) -> Float64Array:
    """``10 log10`` of the distances between (n, 2) and (m, 2), shape (n, m)."""
    distance = np.hypot(a[:, None, 0] - b[None, :, 0], a[:, None, 1] - b[None, :, 1])
    logs: Float64Array = 10.0 * np.log10(np.maximum(distance, _NEAREST_M))
    return logs


def fit_trend(cells: CellReadings, model: StrengthModel) -> Trend:
    """Most probable place of each transmitter on a lattice, with power and decay (ridge regression) there.

    For a place, power and decay are linear; all places of all transmitters are solved at once.
    """
    lattice = _candidates(cells.xy, model)
    logs = _log_distance(lattice, cells.xy).astype(np.float32)
    weight = 1.0 / (cells.noise + model.field_var)
    w, wy = cells.dense(weight), cells.dense(weight * (cells.mean - model.power))
    a11 = w.sum(axis=0) + model.power_sd**-2
    a12 = -(logs @ w)
    a22 = (logs * logs) @ w + model.decay_sd**-2
    b1, b2 = wy.sum(axis=0), model.decay * model.decay_sd**-2 - logs @ wy
    determinant = a11 * a22 - a12**2
    power, decay = (b1 * a22 - a12 * b2) / determinant, (a11 * b2 - a12 * b1) / determinant
    best = (power * b1 + decay * b2).argmax(axis=0)  # the largest reduction of the weighted squares
    each = np.arange(best.shape[0])
    return Trend(
        lattice[best], power[best, each].astype(np.float64) + model.power, decay[best, each].astype(np.float64)
    )


def _candidates(xy: Float64Array, model: StrengthModel) -> Float64Array:
    lo, hi = xy.min(axis=0) - model.reach_m, xy.max(axis=0) + model.reach_m
    spacing = max(model.candidates_m, float(np.sqrt(np.prod(hi - lo) / _MAX_CANDIDATES)))
    xx, yy = np.meshgrid(*(np.arange(lo[k], hi[k] + spacing, spacing) for k in (0, 1)))
    return np.stack([xx.ravel(), yy.ravel()], axis=1)


def fit_strength(cells: CellReadings, x: Float64Array, y: Float64Array, model: StrengthModel) -> Strength:
    """Strength of every transmitter on the grid of axes ``x`` and ``y``, without those that move.

    The mean is exact; the deviation is computed at every other node of every other row and interpolated.
    """
    trend = fit_trend(cells, model)
    xx, yy = (axis.ravel() for axis in np.meshgrid(x, y))
    nodes = np.stack([xx, yy], axis=1)
    coarse = _Coarse.of(x, y)
    to_nodes = _covariance(cells.xy, nodes, model)
    to_coarse = _covariance(cells.xy, coarse.nodes, model)
    between = _covariance(cells.xy, cells.xy, model)
    noise = cells.noise.astype(np.float32)
    n = cells.n_transmitters
    mean, sd = np.empty((n, nodes.shape[0]), np.float32), np.empty((n, coarse.nodes.shape[0]), np.float32)
    steady = np.ones(n, dtype=bool)
    for i in range(n):
        part = slice(cells.first[i], cells.first[i + 1])
        at = cells.cell[part]
        # single precision is enough: the noise on the diagonal keeps the condition below a hundred or two
        inverse, _ = strtri(np.linalg.cholesky(between[np.ix_(at, at)] + np.diag(noise[part])), lower=1)
        alpha = inverse.T @ (inverse @ (cells.mean[part] - trend.strength(i, cells.xy[at])).astype(np.float32))
        excess = _excess(alpha, inverse)
        steady[i] = excess <= model.moves
        mean[i] = trend.strength(i, nodes) + alpha @ to_nodes[at]
        told = inverse @ to_coarse[at]
        left = np.maximum(model.field_var - np.einsum("ij,ij->j", told, told), 0.0)
        sd[i] = np.sqrt(max(excess, 1.0) * (left + model.noise))
    kept = np.flatnonzero(steady)
    return Strength(kept, mean[kept], coarse.refine(sd[kept]))


def _covariance(a: Float64Array, b: Float64Array, model: StrengthModel) -> Float32Array:
    distance = np.hypot(a[:, None, 0] - b[None, :, 0], a[:, None, 1] - b[None, :, 1])
    covariance: Float32Array = (model.field_var * np.exp(-distance / model.length_m)).astype(np.float32)
    return covariance


def _excess(alpha: Float32Array, inverse: Float32Array) -> float:
    """Mean squared standardized residual of each cell when left out (Rasmussen and Williams 2006, section 5.4.2)."""
    z2 = alpha**2 / np.einsum("ij,ij->j", inverse, inverse)
    return float(np.minimum(z2, _Z2_CAP).mean())


@dataclass(frozen=True, slots=True)
class _Coarse:
    """Every other node of every other row, the last ones included."""

    x: Float64Array
    y: Float64Array
    fine: Float64Array
    nodes: Float64Array

    @classmethod
    def of(cls, x: Float64Array, y: Float64Array) -> _Coarse:
        cx, cy = (np.unique(np.append(axis[::2], axis[-1])) for axis in (x, y))
        fine = np.stack([axis.ravel() for axis in np.meshgrid(x, y)], axis=1)
        return cls(cx, cy, fine, np.stack([axis.ravel() for axis in np.meshgrid(cx, cy)], axis=1))

    def refine(self, values: Float32Array) -> Float32Array:
        """Values (n, coarse nodes) at all nodes, bilinear."""
        shape = (len(self.y), len(self.x), values.shape[0])
        known = RegularGridInterpolator((self.y, self.x), values.T.reshape(shape))
        refined: Float32Array = known(self.fine[:, ::-1]).astype(np.float32).T
        return refined
