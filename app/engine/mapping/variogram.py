"""Covariance of a level's samples, chosen by predicting whole walks that were left out."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from app.engine.mapping.kriging import krige
from app.engine.mapping.model import Covariance, FieldLevel, FieldSamples
from app.engine.types import Float64Array, IntArray

LENGTHS_M = (3.0, 5.0, 8.0)
ERRORS = (0.2, 0.4)
_FOLDS = 4
_MAX_POINTS = 1200
_MIN_WALKS = 4
_NEAR_M = 1.0


def field_level(samples: FieldSamples, covariance: Covariance) -> FieldLevel:
    """Mean and spread of the field itself: the samples' variance without the part the covariance calls error."""
    variance = samples.values.var(axis=0)
    sd = np.sqrt(np.maximum(variance / (1.0 + covariance.noise), 0.25))
    return FieldLevel(samples.values.mean(axis=0), sd)


def fit_covariance(samples: FieldSamples, *, seed: int = 0) -> Covariance:
    """Choose field length and walk error by the predictive likelihood of left-out walks.

    Leaving out walks, not points, is what counts: neighbours of one walk share its errors. Too few walks: the
    defaults, which stand for phones in shopping malls.

    The error is kept below what prediction at the labelled places would choose: most of it is labels that are off by
    decimetres along the way, and a walker's own path gives way to these. Charged to the map, they would smooth away the
    fine part of the field, which tells places apart.
    """
    walks = np.unique(samples.walk)
    if len(walks) < _MIN_WALKS:
        return Covariance()
    rng = np.random.default_rng(seed)
    fold = rng.integers(_FOLDS, size=int(samples.walk.max()) + 1)[samples.walk]
    scores = {}
    for length in LENGTHS_M:
        for error in ERRORS:
            candidate = Covariance(length_m=length, error=error)
            scores[candidate] = _predictive_score(samples, candidate, fold, np.random.default_rng(seed))
    best = max(scores, key=lambda c: scores[c])
    return best if np.isfinite(scores[best]) else Covariance()


def repeatability(
    samples: FieldSamples, covariance: Covariance, *, labelled: FieldSamples | None = None, seed: int = 0
) -> Float64Array:
    """What a reading differs from the map by beyond the map's own deviation, shape (channels,), uT.

    Measured on left-out walks; without any that cross others, what the covariance calls error.

    Parameters
    ----------
    samples : FieldSamples
    covariance : Covariance
    labelled : FieldSamples or None
        The same samples where their labels put them, if they were moved since: nobody moves the readings of a session
        to where they agree with the map, so the left-out ones shall not be.
    seed : int
        Of the folds.
    """
    level = field_level(samples, covariance)
    modelled: Float64Array = level.sd * np.sqrt(covariance.noise)
    walks = np.unique(samples.walk)
    if len(walks) < _MIN_WALKS:
        return modelled
    rng = np.random.default_rng(seed)
    fold = rng.integers(_FOLDS, size=int(samples.walk.max()) + 1)[samples.walk]
    residual, sd = _left_out(samples, covariance, fold, rng, labelled)
    if len(residual) < _MIN_WALKS:
        return modelled
    measured = np.sqrt(np.maximum((residual**2 - sd**2).mean(axis=0), 0.0))
    return np.asarray(np.maximum(measured, 0.5 * modelled))


def _predictive_score(samples: FieldSamples, covariance: Covariance, fold: IntArray, rng: np.random.Generator) -> float:
    """Mean log density of left-out samples that have a neighbour of another fold within a metre."""
    residual, sd = _left_out(samples, covariance, fold, rng)
    if len(residual) == 0:
        return -np.inf
    variance = sd**2 + covariance.noise * field_level(samples, covariance).sd ** 2
    return float((-0.5 * residual**2 / variance - 0.5 * np.log(variance)).mean())


def _left_out(
    samples: FieldSamples,
    covariance: Covariance,
    fold: IntArray,
    rng: np.random.Generator,
    labelled: FieldSamples | None = None,
) -> tuple[Float64Array, Float64Array]:
    """Residuals of left-out samples near samples of other folds, and the map's deviation there, (n, channels) each."""
    level = field_level(samples, covariance)
    residuals, deviations = [np.empty((0, samples.values.shape[1]))], [np.empty((0, samples.values.shape[1]))]
    for f in range(_FOLDS):
        known = samples.subset(fold != f)
        asked = (labelled or samples).subset(fold == f)
        if len(known) == 0 or len(asked) == 0:
            continue
        distance, _ = cKDTree(known.xy).query(asked.xy, distance_upper_bound=_NEAR_M)
        near = np.flatnonzero(np.isfinite(distance))
        if near.shape[0] > _MAX_POINTS // _FOLDS:
            near = np.sort(rng.choice(near, _MAX_POINTS // _FOLDS, replace=False))
        if near.shape[0] == 0:
            continue
        asked = asked.subset(near)
        mean, sd = krige(known, level, covariance, asked.xy, neighbours=48)
        residuals.append(asked.values - mean)
        deviations.append(sd)
    return np.concatenate(residuals), np.concatenate(deviations)
