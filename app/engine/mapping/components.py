"""Components of the field that a map does not hold but its channels give: magnitudes, and channels of poorer sets."""

from __future__ import annotations

import numpy as np

from app.engine.types import FeatureSet, Float32Array

_RICHEST_FIRST = (FeatureSet.VECTOR, FeatureSet.HV, FeatureSet.TOTAL)
_PARTS: dict[tuple[FeatureSet, FeatureSet], tuple[tuple[int, ...], ...]] = {
    (FeatureSet.VECTOR, FeatureSet.HV): ((0, 1), (2,)),
    (FeatureSet.VECTOR, FeatureSet.TOTAL): ((0, 1, 2),),
    (FeatureSet.HV, FeatureSet.TOTAL): ((0, 1),),
}
"""Channels of the richer set that each channel of the poorer one is the magnitude of."""


def poorer_features(first: FeatureSet, second: FeatureSet) -> FeatureSet:
    """The set of the two that follows from the other."""
    return max(first, second, key=_RICHEST_FIRST.index)


def as_features(
    mean: Float32Array, sd: Float32Array, features: FeatureSet, wanted: FeatureSet
) -> tuple[Float32Array, Float32Array]:
    """Channels of ``wanted`` from those of ``features``, which is as rich or richer.

    Parameters
    ----------
    mean, sd : array, shape (channels, ...), uT

    Returns
    -------
    mean, sd : array, shape (channels of wanted, ...), uT
    """
    if features is wanted:
        return mean, sd
    parts = [magnitude(mean[list(part)], sd[list(part)]) for part in _PARTS[features, wanted]]
    return np.stack([part[0] for part in parts]), np.stack([part[1] for part in parts])


def magnitude(mean: Float32Array, sd: Float32Array) -> tuple[Float32Array, Float32Array]:
    """Norm of components, and its standard deviation to first order, taking them as independent.

    Parameters
    ----------
    mean, sd : array, shape (components, ...), uT
        Of one component: that itself, with its sign.
    """
    if len(mean) == 1:
        return mean[0], sd[0]
    norm = np.sqrt((mean**2).sum(axis=0))
    with np.errstate(invalid="ignore", divide="ignore"):
        slope_sd = np.sqrt(((mean * sd) ** 2).sum(axis=0)) / norm
    # At a zero of the field no direction is singled out: the mean of the components' variances.
    return norm, np.where(norm > 0, slope_sd, np.sqrt((sd**2).mean(axis=0)))
