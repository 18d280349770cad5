"""What a source's own rows tell of it, before anybody is asked: a field is bounded, continuous and free of curl."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from app.engine.mapping.crowd.policy import PhysicsPolicy, Reason
from app.engine.mapping.model import Covariance, MapModel
from app.engine.types import Evidence, FeatureSet, Float64Array, IntArray, SourceKind

_NEAR_M, _FAR_M = 0.3, 2.0
"""Increments over less are noise, over more they are the coarse field's, which a level has few of."""
_CLOSED_M = 0.75
"""A way is closed where it comes back this near."""
_LOOP_M = 12.0
"""A shorter way round encloses hardly anything but noise."""
_STEP_M = 1.0
"""Rows farther apart are not neighbours along a way."""


def implausible(evidence: Evidence, model: MapModel, policy: PhysicsPolicy) -> dict[int, Reason]:
    """Sessions whose field cannot be one: index of the source -> the first reason found."""
    found: dict[int, Reason] = {}
    by_source = np.argsort(evidence.source, kind="stable")
    owners, first = np.unique(evidence.source[by_source], return_index=True)
    for source, rows in zip(owners.tolist(), np.split(by_source, first[1:]), strict=True):
        if evidence.sources[source].kind is SourceKind.SURVEY:
            continue
        reason = _judge(evidence, rows, model, policy)
        if reason is not None:
            found[source] = reason
    return found


def _judge(evidence: Evidence, rows: IntArray, model: MapModel, policy: PhysicsPolicy) -> Reason | None:
    """Rows of one source, in the order of its way."""
    xy, values = evidence.xy[rows].astype(np.float64), evidence.values[rows].astype(np.float64)
    if not np.isfinite(values).all() or np.linalg.norm(values, axis=1).max() > policy.amplitude_ut:
        return Reason.AMPLITUDE
    way = np.linalg.norm(np.diff(xy, axis=0), axis=1)
    increment = np.diff(values, axis=0)
    near = way < policy.jump_m
    jumps = near & (np.linalg.norm(increment, axis=1) > policy.jump_ut)
    if jumps.sum() > max(policy.jumps * near.sum(), 1.0):
        return Reason.JUMP
    ratio = roughness(way, increment, model)
    if ratio is not None and len(way) >= policy.least_pairs:
        if ratio > policy.rough:
            return Reason.ROUGH
        if ratio < policy.smooth:
            return Reason.SMOOTH
    if evidence.features is FeatureSet.VECTOR:
        score = circulation(xy, values, evidence.spread[rows].astype(np.float64), model)
        if score > policy.circulation:
            return Reason.CURL
    return None


def roughness(way: Float64Array, increment: Float64Array, model: MapModel) -> float | None:
    """Mean squared increment of the field over what the covariance expects; None without increments of use.

    Parameters
    ----------
    way : array, shape (n,), m
        Distance of the two rows of each increment.
    increment : array, shape (n, channels), uT
    model : MapModel
    """
    used = (way >= _NEAR_M) & (way <= _FAR_M)
    if not used.any():
        return None
    squared = ((increment[used] / model.level.sd) ** 2).mean(axis=1)
    return float(squared.mean() / _expected(way[used], model.covariance).mean())


def _expected(d: Float64Array, covariance: Covariance) -> Float64Array:
    """Squared difference of two rows of one walk that are ``d`` apart, units of the field's variance."""
    coarse, fine = np.sqrt(3.0) * d / covariance.length_m, np.sqrt(3.0) * d / covariance.fine_length_m
    field = (1.0 - covariance.fine) * (1.0 + coarse) * np.exp(-coarse) + covariance.fine * (1.0 + fine) * np.exp(-fine)
    own = covariance.error * (1.0 - np.exp(-d / covariance.error_length_m))
    return np.asarray(2.0 * (1.0 - field + own + covariance.white))


def circulation(xy: Float64Array, values: Float64Array, spread: Float64Array, model: MapModel) -> float:
    """Largest line integral of the horizontal field round a closed way, in standard deviations of its noise.

    Without currents through the floor the integral is nought (Ampere's law), whatever offset the level frame's field
    has. Of a magnet carried along it is not: its field goes round with the walker.

    Parameters
    ----------
    xy : array, shape (n, 2), m
        In the order of the way.
    values : array, shape (n, 3), uT
    spread : array, shape (n,), m
    model : MapModel
    """
    step = np.diff(xy, axis=0)
    length = np.linalg.norm(step, axis=1)
    run = np.concatenate([[0], np.cumsum(length > _STEP_M)])
    along = np.concatenate([[0.0], np.cumsum(length)])
    middle = 0.5 * (values[1:, :2] + values[:-1, :2])
    integral = np.concatenate([[0.0], np.cumsum((middle * step).sum(axis=1))])
    a, b = _closures(xy, along, run)
    if not len(a):
        return 0.0
    closing = (0.5 * (values[a, :2] + values[b, :2]) * (xy[a] - xy[b])).sum(axis=1)
    around = along[b] - along[a]
    covariance = model.covariance
    noise = covariance.error + covariance.white + float(np.mean(covariance.position_variance(spread)))
    sd = float(np.sqrt(np.mean(model.level.sd[:2] ** 2)))
    # the error is one and the same over twice its length: so much way has one independent error
    deviation = sd * np.sqrt(noise * 2.0 * covariance.error_length_m * around)
    return float(np.max(np.abs(integral[b] - integral[a] + closing) / deviation))


def _closures(xy: Float64Array, along: Float64Array, run: IntArray) -> tuple[IntArray, IntArray]:
    """First and last row of each way that closes without a break."""
    pairs = cKDTree(xy).query_pairs(_CLOSED_M, output_type="ndarray")
    a, b = pairs.min(axis=1, initial=len(xy)), pairs.max(axis=1, initial=0)
    closed = (run[a] == run[b]) & (along[b] - along[a] >= _LOOP_M) if len(pairs) else np.zeros(0, dtype=np.bool_)
    return a[closed], b[closed]
