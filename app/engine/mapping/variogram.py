"""Covariance of a level's samples, and what they deviate by, from predicting whole walks that were left out.

Leaving out walks, not points, is what counts: neighbours of one walk share its errors. A left-out walk is compared as a
session would be: its own offsets are found on the map of the others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from app.engine.mapping.kriging import krige
from app.engine.mapping.model import Covariance, FieldLevel, FieldSamples
from app.engine.mapping.offsets import SAMPLES_A_WITNESS, estimate_offsets, offsets_on_map
from app.engine.mapping.samples import PlacedSamples
from app.engine.types import BoolArray, Float64Array, IntArray

PARTS_M = ((5.0, 1.5, 0.5), (3.0, 1.5, 0.5), (8.0, 2.5, 0.5), (15.0, 3.0, 0.4), (15.0, 4.0, 0.6))
"""Coarse length, fine length, variance of the fine part; the defaults first, which stand where nothing tells."""
ERRORS = (0.4, 0.2, 0.7)
STRETCH = 1.5
ANGLES = (0.0, np.pi / 4, np.pi / 2, 3 * np.pi / 4)
LEAST_GAIN = 0.005
"""Log density per sample that what is special about a level must bring: less is chance with a few dozen walks."""
WITHIN_M = 4.0
"""Left-out samples farther from all others than this tell nothing of the map."""
GROSS_WEIGHT = 0.15
"""A walk with a mean weight below this is wrong as a whole."""
_FOLDS = 4
_NEAR_M = 1.0
_MAX_POINTS = 1600
_MIN_WALKS = 4
_NEIGHBOURS = 48
_SCALES = np.arange(0.7, 1.31, 0.05)
"""A level's few dozen walks do not tell more extreme ones from chance."""


@dataclass(frozen=True, slots=True)
class Claims:
    """What makes the map's claims true on left-out walks.

    Attributes
    ----------
    scale : float
        By which the deviation that the samples' variance tells is to be multiplied.
    noise_sd : array, shape (channels,), uT
        What a reading differs from the field by, once the offsets of its walk are removed.
    """

    scale: float
    noise_sd: Float64Array


def field_level(samples: FieldSamples, covariance: Covariance) -> FieldLevel:
    """Mean and spread of the field itself: the samples' variance without the part the covariance calls error."""
    mean = np.average(samples.values, axis=0, weights=samples.weight)
    spread = np.average((samples.values - mean) ** 2, axis=0, weights=samples.weight)
    variance = np.maximum(spread / (1.0 + covariance.noise), 0.25)
    if covariance.curl_free:
        sills = covariance.gradient_sills
        variance[:2] = variance[:2].sum() * sills / sills.sum()
    return FieldLevel(mean, np.sqrt(variance))


def fit_covariance(
    samples: FieldSamples,
    walks: Sequence[PlacedSamples] | None = None,
    *,
    labelled: FieldSamples | None = None,
    seed: int = 0,
) -> Covariance:
    """Choose the covariance by the predictive likelihood of left-out walks.

    First the lengths, then the walk error, and last whether the horizontal components are better taken together, as the
    gradient of a potential, and whether the field is longer in one direction. Too few walks: the defaults, which stand
    for phones in shopping malls.

    Parameters
    ----------
    samples : FieldSamples
    walks : sequence of PlacedSamples or None
        The same samples before their offsets were taken off, for channels that are the vector's. Without, each
        left-out walk may be off by a constant per channel.
    labelled : FieldSamples or None
        The samples where their labels put them, if they were moved since: nobody moves the readings of a session to
        where they agree with the map, so the left-out ones shall not be.
    seed : int
        Of the sharing out.
    """
    if len(np.unique(samples.walk)) < _MIN_WALKS:
        return Covariance()
    asked = _LeftOut.draw(samples, walks, seed, labelled)
    best = asked.best([Covariance(long, fine=fine, fine_length_m=short) for long, short, fine in PARTS_M])
    best = asked.best([replace(best, error=error) for error in ERRORS])
    if samples.values.shape[1] == len("xyz"):
        best = asked.best([best, replace(best, curl_free=True)], LEAST_GAIN)
    return asked.best([best, *(replace(best, stretch=STRETCH, stretch_angle=angle) for angle in ANGLES)], LEAST_GAIN)


def fit_claims(
    samples: FieldSamples,
    covariance: Covariance,
    walks: Sequence[PlacedSamples] | None = None,
    *,
    labelled: FieldSamples | None = None,
    seed: int = 0,
) -> Claims:
    """Deviation of the field and of a reading about it, so that left-out walks differ from the map as claimed.

    A residual has variance ``(scale * sd)^2 + noise_sd^2``: ``sd`` grows with the distance from the samples and the
    noise does not, so both can be told, by maximum likelihood. Without walks that cross others: what the covariance
    calls error.

    Parameters
    ----------
    samples, covariance, walks, labelled, seed
        As in :func:`fit_covariance`.
    """
    level = field_level(samples, covariance)
    modelled: Float64Array = level.sd * np.sqrt(covariance.noise)
    claims = Claims(1.0, modelled)
    if len(np.unique(samples.walk)) < _MIN_WALKS:
        return claims
    residual, sd = _LeftOut.draw(samples, walks, seed, labelled).residuals(covariance)
    if len(residual) < _MIN_WALKS:
        return claims
    scale, noise = _likeliest(residual, sd)
    return Claims(scale, np.maximum(noise, 0.3 * modelled))


def repeatability(
    samples: FieldSamples, covariance: Covariance, *, labelled: FieldSamples | None = None, seed: int = 0
) -> Float64Array:
    """What a reading of a session differs from the map by beyond the map's own deviation, shape (channels,), uT.

    More than :func:`fit_claims` says: a session knows its offsets only as well as the walks of a survey know theirs
    together, not as the whole of a walk would tell them. Measured on left-out walks near others; without any, what the
    covariance calls error.

    Parameters
    ----------
    samples, covariance, labelled, seed
        As in :func:`fit_claims`.
    """
    level = field_level(samples, covariance)
    modelled: Float64Array = level.sd * np.sqrt(covariance.noise)
    if len(np.unique(samples.walk)) < _MIN_WALKS:
        return modelled
    places, rng = (labelled or samples).xy, np.random.default_rng(seed)
    fold = rng.integers(_FOLDS, size=int(samples.walk.max()) + 1)[samples.walk]
    excess = [np.empty((0, samples.values.shape[1]))]
    for f in range(_FOLDS):
        known, rows = samples.subset(fold != f), np.flatnonzero((fold == f) & ~_gross(samples))
        if not len(known) or not len(rows):
            continue
        near = rows[cKDTree(known.xy).query(places[rows])[0] <= _NEAR_M]
        near = near[:: max(1, len(near) * _FOLDS // _MAX_POINTS)]
        if len(near):
            mean, sd = krige(known, level, covariance, places[near], neighbours=_NEIGHBOURS)
            excess.append((samples.values[near] - mean) ** 2 - sd**2)
    told = np.concatenate(excess)
    if len(told) < _MIN_WALKS:
        return modelled
    return np.asarray(np.maximum(np.sqrt(np.maximum(told.mean(axis=0), 0.0)), 0.5 * modelled))


def _likeliest(residual: Float64Array, sd: Float64Array) -> tuple[float, Float64Array]:
    """Scale of ``sd`` that a Gaussian makes most of, and the noise of each channel that makes its claims true."""
    scores = [_log_density(residual, scale * sd) for scale in _SCALES.tolist()]
    scale = float(_SCALES[int(np.argmax(scores))])
    return scale, np.sqrt(_noise(residual, scale * sd))


def _noise(residual: Float64Array, sd: Float64Array) -> Float64Array:
    """Noise variance of each channel with which the mean of squared residuals over claimed variances is one."""
    return np.array([_balance(r**2, s**2) for r, s in zip(residual.T, sd.T, strict=True)])


def _log_density(residual: Float64Array, sd: Float64Array) -> float:
    """Mean Gaussian log density, but for a constant, with that noise."""
    variance = sd**2 + _noise(residual, sd)
    return float((-0.5 * residual**2 / variance - 0.5 * np.log(variance)).mean())


def _balance(square: Float64Array, map_variance: Float64Array) -> float:
    """Noise variance with which the mean of squared residuals over claimed variances is one; 0 if none is needed."""
    low, high = 0.0, float(square.mean()) + 1e-12
    if (square / np.maximum(map_variance, 1e-12)).mean() <= 1.0:
        return 0.0
    while (square / (map_variance + high)).mean() > 1.0:
        high *= 2.0
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if (square / (map_variance + middle)).mean() > 1.0 else (low, middle)
    return high


def _known(samples: FieldSamples, walks: Sequence[PlacedSamples] | None, kept: IntArray) -> FieldSamples:
    """What the kept walks tell, their offsets found without the others."""
    known = samples.subset(np.isin(samples.walk, kept))
    if walks is None or not len(known):
        return known
    own = [walks[i] for i in kept]
    offsets = estimate_offsets(own, known.weight)
    return replace(known, values=np.concatenate([offsets.field(i, walk) for i, walk in enumerate(own)]))


def _gross(samples: FieldSamples) -> BoolArray:
    """Samples of walks that most of the others contradict: how they differ says nothing of the next one."""
    if samples.weight is None:
        return np.zeros(len(samples), dtype=bool)
    count = np.bincount(samples.walk)
    usual = np.bincount(samples.walk, samples.weight) / np.maximum(count, 1)
    return np.asarray(usual[samples.walk] < GROSS_WEIGHT)


@dataclass(frozen=True, slots=True)
class _LeftOut:
    """Walks shared out among folds, and the samples of them that are predicted.

    ``asked`` indexes ``samples``; ``places`` is where their prediction is asked, by labels or as adjusted; ``known`` is
    what the walks of the other folds tell, for each fold.
    """

    samples: FieldSamples
    places: Float64Array
    walks: Sequence[PlacedSamples] | None
    begin: IntArray
    fold: IntArray
    asked: IntArray
    known: tuple[FieldSamples, ...]

    @classmethod
    def draw(
        cls,
        samples: FieldSamples,
        walks: Sequence[PlacedSamples] | None,
        seed: int,
        labelled: FieldSamples | None = None,
    ) -> _LeftOut:
        rng = np.random.default_rng(seed)
        n_walks = int(samples.walk.max()) + 1
        fold = rng.permutation(n_walks) % _FOLDS
        places = (labelled or samples).xy
        near = np.zeros(len(samples), dtype=bool)
        for f in range(_FOLDS):
            out = fold[samples.walk] == f
            if out.any() and not out.all():
                near[out] = cKDTree(samples.xy[~out]).query(places[out])[0] <= WITHIN_M
        asked = np.flatnonzero(near & ~_gross(samples))
        asked = asked[:: max(1, len(asked) // _MAX_POINTS)]
        known = tuple(_known(samples, walks, np.flatnonzero(fold != f)) for f in range(_FOLDS))
        return cls(samples, places, walks, np.searchsorted(samples.walk, np.arange(n_walks)), fold, asked, known)

    def best(self, candidates: Sequence[Covariance], least_gain: float = 0.0) -> Covariance:
        """The candidate of the highest score, if it beats the first by enough."""
        scores = [self.score(candidate) for candidate in candidates]
        best = int(np.argmax(scores))
        return candidates[best] if scores[best] >= scores[0] + least_gain else candidates[0]

    def score(self, covariance: Covariance) -> float:
        """Mean log density of what is left out, with the noise that serves this covariance best."""
        residual, sd = self.residuals(covariance)
        if len(residual) == 0:
            return -np.inf
        return _log_density(residual, sd)

    def residuals(self, covariance: Covariance) -> tuple[Float64Array, Float64Array]:
        """Left-out samples less the others' map, offsets of their walks removed, and its deviation, (n, channels)."""
        level = field_level(self.samples, covariance)
        parts = []
        for f in range(_FOLDS):
            rows = self.asked[self.fold[self.samples.walk[self.asked]] == f]
            known = self.known[f]
            if not len(rows) or not len(known):
                continue
            mean, sd = krige(known, level, covariance, self.places[rows], neighbours=_NEIGHBOURS)
            owner = self.samples.walk[rows]
            for i in np.unique(owner):
                of = owner == i
                noise = covariance.noise * level.sd**2
                parts.append((self._residual(int(i), rows[of], mean[of], sd[of] ** 2 + noise), sd[of]))
        channels = self.samples.values.shape[1]
        none = np.empty((0, channels))
        return np.concatenate([none, *(r for r, _ in parts)]), np.concatenate([none, *(s for _, s in parts)])

    def _residual(self, i: int, rows: IntArray, mean: Float64Array, variance: Float64Array) -> Float64Array:
        if self.walks is None or mean.shape[1] != len("xyz"):
            residual = self.samples.values[rows] - mean
            precision = 1.0 / variance
            # shrunk towards none by the weight of one independent sample
            offset = (precision * residual).sum(axis=0) / (precision.sum(axis=0) + SAMPLES_A_WITNESS * precision.max())
            return np.asarray(residual - offset)
        part = self.walks[i].subset(rows - self.begin[i])
        offsets = offsets_on_map(part, mean, variance)
        return offsets.field(part) - mean
