"""Survey walks moved to where their field agrees with the other walks'.

Labels are good to half a metre or a metre, and people do not walk at an even pace between them. Along a corridor
that is enough to smear the fine part of the field, which tells places apart. Each walk is therefore compared with a map
of the *others*: how far it has to be moved, along its way and across it, is a slowly varying unknown with a prior of
what labels are worth. Where the others never were, their map says nothing and the walk stays where its labels put it.

The posterior of the displacement is found on a lattice, forward and backward through the walk (Rabiner 1989,
doi:10.1109/5.18626, section III): no start is needed, and a second place that fits as well does no harm, it merely
widens the posterior. Its mean is taken.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import map_coordinates

from app.engine.mapping.kriging import krige_grid
from app.engine.mapping.model import Covariance, FieldLevel, FieldSamples
from app.engine.mapping.offsets import estimate_offsets
from app.engine.mapping.samples import PlacedSamples
from app.engine.mapping.variogram import field_level
from app.engine.types import BoolArray, Float64Array, GridMap, IntArray, Progress

_FOLDS = 4
_MIN_WALKS = 4
_CELL_M = 0.5
_MARGIN_M = 2.0
_NEIGHBOURS = 24
_COVARIANCE = Covariance(length_m=5.0, error=0.2)
_SMOOTH = 5
"""Samples over which the direction of a walk is averaged: labels are joined by straight legs with corners."""
_STANDING_M = 1e-3
_LEAST_STEP_M = 0.05


@dataclass(frozen=True, slots=True)
class AdjustmentPolicy:
    """What displacements are expected, and what a sample's field counts for; fitted on left-out survey walks.

    Attributes
    ----------
    along_m, across_m : float, m
        Standard deviation of the displacement along the walk and across it.
    length_m : float, m
        Way after which a displacement is forgotten (exponential): about a leg between two labels.
    temper : float
        Weight of one sample (two a step): neighbours err together.
    degrees_of_freedom : float
        Of the Student t that a sample's field is compared by.
    lattice_m : float, m
        Spacing of the displacements tried.
    reach_along, reach_across : int
        So many of them on either side.
    rounds : int
        Times that all walks are moved; each starts from the labels with the maps of the round before.
    """

    along_m: float = 0.8
    across_m: float = 0.5
    length_m: float = 5.0
    temper: float = 0.25
    degrees_of_freedom: float = 4.0
    lattice_m: float = 0.25
    reach_along: int = 8
    reach_across: int = 4
    rounds: int = 2


def adjust_walks(
    placed: Sequence[PlacedSamples],
    policy: AdjustmentPolicy | None = None,
    *,
    seed: int = 0,
    progress: Progress | None = None,
) -> list[PlacedSamples]:
    """Move the samples of survey walks to where they agree best with the other walks.

    Each round shares the walks out among four groups and compares those of a group with a map of the rest, so that no
    walk confirms itself.

    Parameters
    ----------
    placed : sequence of PlacedSamples
        By their labels. Fewer than four are returned as they are.
    policy : AdjustmentPolicy
    seed : int
        Of the sharing out.
    progress : callable or None

    Returns
    -------
    list of PlacedSamples
        In the same order, with other ``xy``.
    """
    policy = policy or AdjustmentPolicy()
    if len(placed) < _MIN_WALKS:
        return list(placed)
    rng = np.random.default_rng(seed)
    moved = list(placed)
    for done in range(policy.rounds):
        if progress is not None:
            progress(done / policy.rounds, f"aligning walks, round {done + 1} of {policy.rounds}")
        fold = rng.permutation(len(placed)) % _FOLDS
        samples, maps = _maps_of_the_others(moved, fold)
        moved = [
            replace(walk, xy=walk.xy + displacement(walk, samples.values[samples.walk == i], maps[fold[i]], policy))
            for i, walk in enumerate(placed)
        ]
    return moved


def displacement(walk: PlacedSamples, field: Float64Array, others: OthersMap, policy: AdjustmentPolicy) -> Float64Array:
    """Posterior mean of how far each sample of a walk has to be moved, shape (n, 2), m, level frame.

    Parameters
    ----------
    walk : PlacedSamples
        By its labels.
    field : array, shape (n, 3), uT
        Its field in the level frame, offsets taken off.
    others : OthersMap
    """
    along, across = _axes_of(walk.xy)
    u, v = (
        policy.lattice_m * np.arange(-n, n + 1, dtype=np.float64) for n in (policy.reach_along, policy.reach_across)
    )
    tried = (
        walk.xy[:, None, None]
        + u[None, :, None, None] * along[:, None, None]
        + v[None, None, :, None] * across[:, None, None]
    )
    log = policy.temper * others.log_likelihood(field, tried, policy.degrees_of_freedom)
    step = np.maximum(np.hypot(*np.diff(walk.xy, axis=0).T), _LEAST_STEP_M)
    posterior = _forward_backward(log, u, v, np.exp(-step / policy.length_m), policy)
    moved: Float64Array = (posterior.sum(axis=2) @ u)[:, None] * along + (posterior.sum(axis=1) @ v)[:, None] * across
    return moved


@dataclass(frozen=True, slots=True)
class OthersMap:
    """Map of the walks of other groups.

    Attributes
    ----------
    x0, y0 : float, m
        Node ``[0, 0]``.
    mean, sd : arrays, shape (3, rows, columns), uT
    noise_sd : array, shape (3,), uT
        What a sample differs from the field by.
    cell_m : float, m
    """

    x0: float
    y0: float
    mean: Float64Array
    sd: Float64Array
    noise_sd: Float64Array
    cell_m: float = _CELL_M

    @classmethod
    def of(cls, grid_map: GridMap) -> OthersMap:
        """A finished map of the vector field."""
        mean, sd = grid_map.mean.astype(np.float64), grid_map.sd.astype(np.float64)
        return cls(grid_map.x0, grid_map.y0, mean, sd, np.array(grid_map.noise_sd), grid_map.cell_m)

    def log_likelihood(self, field: Float64Array, xy: Float64Array, degrees_of_freedom: float) -> Float64Array:
        """Student t log density, but for a constant, of ``field`` (n, 3) at ``xy`` (n, a, b, 2); shape (n, a, b)."""
        at = np.stack([(xy[..., 1] - self.y0) / self.cell_m, (xy[..., 0] - self.x0) / self.cell_m])
        square, log_sd = np.zeros(xy.shape[:-1]), np.zeros(xy.shape[:-1])
        for c in range(3):
            mean, sd = (map_coordinates(layer[c], at, order=1, mode="nearest") for layer in (self.mean, self.sd))
            variance = sd**2 + self.noise_sd[c] ** 2
            square += (field[:, None, None, c] - mean) ** 2 / variance
            log_sd += 0.5 * np.log(variance)
        half = 0.5 * (degrees_of_freedom + 3.0)
        return np.asarray(-log_sd - half * np.log1p(square / degrees_of_freedom))


def _maps_of_the_others(walks: Sequence[PlacedSamples], fold: IntArray) -> tuple[FieldSamples, list[OthersMap]]:
    """Samples of all walks with their offsets taken off, and for each group the map of the others."""
    offsets = estimate_offsets(walks)
    samples = FieldSamples(
        np.concatenate([walk.xy for walk in walks]),
        np.concatenate([np.full(len(walk), i) for i, walk in enumerate(walks)]),
        np.concatenate([offsets.field(i, walk) for i, walk in enumerate(walks)]),
    )
    level = field_level(samples, _COVARIANCE)
    x, y = (
        _CELL_M * np.arange(np.floor((v.min() - _MARGIN_M) / _CELL_M), np.ceil((v.max() + _MARGIN_M) / _CELL_M) + 1)
        for v in samples.xy.T
    )
    owner = fold[samples.walk]
    return samples, [_map_without(samples, owner == f, level, x, y) for f in range(_FOLDS)]


def _map_without(
    samples: FieldSamples,
    left_out: BoolArray,
    level: FieldLevel,
    x: Float64Array,
    y: Float64Array,
) -> OthersMap:
    mean, sd = krige_grid(samples.subset(~left_out), level, _COVARIANCE, x, y, neighbours=_NEIGHBOURS)
    return OthersMap(float(x[0]), float(y[0]), mean, sd, level.sd * np.sqrt(_COVARIANCE.noise))


def _axes_of(xy: Float64Array) -> tuple[Float64Array, Float64Array]:
    """Unit vectors along a walk and to its left at each sample, shape (n, 2) each; who stands keeps the last one."""
    half = _SMOOTH // 2
    padded = np.pad(np.gradient(xy, axis=0), ((half, half), (0, 0)), mode="edge")
    window = np.full(_SMOOTH, 1.0 / _SMOOTH)
    way = np.stack([np.convolve(padded[:, axis], window, "valid") for axis in (0, 1)], axis=1)
    length = np.hypot(*way.T)
    last = np.maximum.accumulate(np.where(length > _STANDING_M, np.arange(len(xy)), 0))
    along = way[last] / np.maximum(length[last], _STANDING_M)[:, None]
    return along, np.stack([-along[:, 1], along[:, 0]], axis=1)


def _forward_backward(
    log: Float64Array, u: Float64Array, v: Float64Array, keep: Float64Array, policy: AdjustmentPolicy
) -> Float64Array:
    """Posterior over the lattice at each sample, shape (n, len(u), len(v)); ``keep`` (n - 1,) from one to the next."""
    likelihood = np.exp(log - log.max(axis=(1, 2), keepdims=True))
    moves = [(_transition(u, policy.along_m, k), _transition(v, policy.across_m, k)) for k in keep.tolist()]
    forward: Float64Array = np.empty(likelihood.shape)
    belief = np.exp(-0.5 * (u / policy.along_m) ** 2)[:, None] * np.exp(-0.5 * (v / policy.across_m) ** 2)
    for i in range(len(likelihood)):
        if i:
            along, across = moves[i - 1]
            belief = along.T @ belief @ across
        belief = belief * likelihood[i]
        belief /= belief.sum()
        forward[i] = belief
    posterior, backward = forward, np.ones_like(belief)
    for i in range(len(likelihood) - 2, -1, -1):
        along, across = moves[i]
        backward = along @ (backward * likelihood[i + 1]) @ across.T
        backward /= backward.max()
        posterior[i] *= backward
        posterior[i] /= posterior[i].sum()
    return posterior


def _transition(lattice: Float64Array, sd: float, keep: float) -> Float64Array:
    """Row: from, column: to. A first-order Markov process (Ornstein-Uhlenbeck) with deviation ``sd``."""
    spread = sd * float(np.sqrt(1.0 - keep**2))
    density = np.exp(-0.5 * ((lattice[None, :] - keep * lattice[:, None]) / spread) ** 2)
    return np.asarray(density / density.sum(axis=1, keepdims=True))
