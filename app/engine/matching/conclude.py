"""From what a search found to what may be claimed: one judgement for all matchers.

A search orders placements by its own criterion; whether the best of them is *right* is another question. It is
answered here, for all methods alike: by the likelihood of the readings at each placement, with errors that are
correlated along the track counted once, and by what the map's slope tells there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from app.engine.matching.field import MapReading, read_map
from app.engine.matching.problem import MatchProblem, Profile, Region, common_features
from app.engine.matching.result import Candidate, Evidence, LocatedTrack, MatchResult
from app.engine.types import FeatureSet, Float64Array, Status

_WALK_ON_M = 5.0
_LISTED = 8
_TURN_SD, _SCALE_SD = 0.1, 0.1
"""rad, -: of the track's shape where no region says better."""


@dataclass(frozen=True, slots=True)
class JudgementPolicy:
    """Thresholds.

    Attributes
    ----------
    won : float
        Weight from which one place is the answer.
    listed : float
        Weight that the listed places must hold together for the answer to be ambiguous; below it is insufficient.
    settled_cells : float
        Semi-axis (one sigma), in cells of the map, above which the field does not tell the place.
    mapped : float
        Share of the placement that must lie on mapped ground.
    distinct_sigmas, distinct_cells : float
        A placement nearer than either to a likelier one is that one.
    explained : float
        Residuals above this many times what map, walk and sensor account for are another field than the map's: none
        of the places found is the right one.
    """

    won: float = 0.95
    listed: float = 0.8
    settled_cells: float = 10.0
    mapped: float = 0.5
    distinct_sigmas: float = 3.0
    distinct_cells: float = 4.0
    explained: float = 5.0


@dataclass(frozen=True, slots=True)
class Fit:
    """A candidate against the map.

    Attributes
    ----------
    candidate : Candidate
    residual : array, shape (n, channels), uT
        Reading less map, less the sensor's offset; vectors in the device's frame.
    variance : array, shape (n, channels), uT^2
        Of map, walk and sensor.
    chi2 : float
        Of all readings, were they independent.
    log_variance : float
        Sum of the logarithms of all variances.
    offset_chi2 : float
        Of the sensor's offset.
    information : array, shape (4, 4)
        Of shift (m), turn (rad) and stretch of the whole track about its first point, were readings independent.
    reading : MapReading
    """

    candidate: Candidate
    residual: Float64Array
    variance: Float64Array
    chi2: float
    log_variance: float
    offset_chi2: float
    information: Float64Array
    reading: MapReading


def conclude(
    problem: MatchProblem,
    candidates: Sequence[Candidate],
    *,
    evaluated: int,
    iterations: int = 0,
    converged: bool = True,
    note: str = "",
    policy: JudgementPolicy | None = None,
) -> MatchResult:
    """Weigh the candidates of a search and say what may be claimed.

    Parameters
    ----------
    problem : MatchProblem
    candidates : sequence of Candidate
        In any order; near ones are merged.
    evaluated : int
        Placements that the search tried.
    iterations, converged, note
        As in :class:`Evidence`.
    policy : JudgementPolicy or None
    """
    policy = policy or JudgementPolicy()
    if not candidates:
        evidence = Evidence(evaluated, np.nan, np.nan, 0.0, np.inf, iterations, converged, note or "nothing was found")
        return MatchResult(Status.INSUFFICIENT, (), evidence, walk_on_m=_WALK_ON_M)
    features = common_features(problem.profile.features, problem.grid_map.features)
    fits = [fit_candidate(problem, one, problem.profile.as_features(features)) for one in candidates]
    best = min(fits, key=lambda fit: fit.chi2)
    share = independent_share(best.residual / np.sqrt(best.variance))
    # What the best place leaves unexplained is error of some kind: without it, many readings would be sure of anything.
    inflation = max(1.0, best.chi2 / best.residual.size)
    log = np.array([_log_likelihood(problem.region, fit, share, inflation) for fit in fits])
    covs = [_covariance(problem, fit, share / inflation) for fit in fits]
    kept = _distinct(fits, covs, log, problem.grid_map.cell_m, policy)
    weight = np.exp(log[kept] - log[kept].max())
    weight /= weight.sum()
    matches = tuple(
        _located(fits[i].candidate, covs[i], float(w)) for i, w in zip(kept[:_LISTED], weight, strict=False)
    )
    first = fits[kept[0]]
    evidence = Evidence(
        evaluated=evaluated,
        residual_rms=float(np.sqrt((first.residual**2).mean())),
        expected_rms=float(np.sqrt(first.variance.mean())),
        mapped=float(first.reading.mapped.mean()),
        information_m=major_axis(_shift_covariance(first.information * (share / inflation))),
        iterations=iterations,
        converged=converged,
        note=note,
    )
    status = _status(matches, evidence, problem.grid_map.cell_m, policy)
    ask = status in (Status.INSUFFICIENT, Status.AMBIGUOUS)
    return MatchResult(status, matches, evidence, max(_WALK_ON_M, 0.5 * problem.track.length_m) if ask else None)


def fit_candidate(problem: MatchProblem, candidate: Candidate, profile: Profile) -> Fit:
    """A placement against the map, with the sensor's offset taken out (Gaussian prior, marginalized)."""
    reading = read_map(problem.grid_map, profile.features, candidate.x, candidate.y)
    residual = profile.turned(candidate.rotation).values - reading.mean
    away = np.stack([candidate.x - candidate.x[0], candidate.y - candidate.y[0]], axis=1)
    slopes = _slopes(reading, profile, candidate, away)
    noise_sd = _walk_noise(problem, profile)
    variance = reading.sd**2 + profile.noise_sd**2 + noise_sd**2
    if profile.features is FeatureSet.VECTOR:  # the offset is the device's: it turns with it
        angle = -(problem.track.heading + candidate.rotation)
        residual, slopes = _turned(residual[:, :, None], angle)[:, :, 0], _turned(slopes, angle)
        variance = np.concatenate([np.repeat(variance[:, :2].mean(axis=1)[:, None], 2, axis=1), variance[:, 2:]], 1)
    offset = np.zeros(residual.shape[1])
    if profile.offset_sd > 0.0:
        w = 1.0 / variance
        total = w.sum(axis=0) + profile.offset_sd**-2
        offset = (w * residual).sum(axis=0) / total
        slopes = slopes - ((w[:, :, None] * slopes).sum(axis=0) / total[:, None])[None]
        residual = residual - offset
    weighted = slopes / variance[:, :, None]
    return Fit(
        candidate=candidate,
        residual=residual,
        variance=variance,
        chi2=float((residual**2 / variance).sum()),
        log_variance=float(np.log(variance).sum()),
        offset_chi2=float((offset**2).sum() / profile.offset_sd**2) if profile.offset_sd > 0.0 else 0.0,
        information=np.einsum("nci,ncj->ij", weighted, slopes),
        reading=reading,
    )


def independent_share(standardized: Float64Array) -> float:
    """Part of the readings that counts, were they independent: of first-order correlation along the track.

    Parameters
    ----------
    standardized : array, shape (n, channels)
        Residuals over their standard deviations.
    """
    n = standardized.shape[0]
    if n < 3:
        return 1.0
    centred = standardized - standardized.mean(axis=0)
    power = float((centred**2).sum())
    along = float((centred[1:] * centred[:-1]).sum()) / power if power > 0.0 else 0.0
    rho = min(max(along, 0.0), 1.0 - 2.0 / n)
    return float((1.0 - rho) / (1.0 + rho))


def major_axis(cov: Float64Array) -> float:
    """Major semi-axis, one sigma, of a covariance of shape (2, 2)."""
    return float(np.sqrt(max(float(np.linalg.eigvalsh(cov)[-1]), 0.0))) if np.all(np.isfinite(cov)) else float("inf")


def _walk_noise(problem: MatchProblem, profile: Profile) -> Float64Array:
    """What two walks over one spot differ by, in the profile's features."""
    own = np.asarray(problem.grid_map.noise_sd, dtype=np.float64)
    if len(own) == profile.values.shape[1]:
        return own
    return np.full(profile.values.shape[1], np.sqrt((own**2).mean()))


def _slopes(reading: MapReading, profile: Profile, candidate: Candidate, away: Float64Array) -> Float64Array:
    """Change of map less reading per metre east, north, per radian and per unit of scale, shape (n, channels, 4)."""
    g = reading.gradient
    turn = -g[:, :, 0] * away[:, None, 1] + g[:, :, 1] * away[:, None, 0]
    if profile.features is FeatureSet.VECTOR:
        v = profile.turned(candidate.rotation).values
        turn = turn - np.stack([-v[:, 1], v[:, 0], np.zeros(len(v))], axis=1)
    stretch = (g[:, :, 0] * away[:, None, 0] + g[:, :, 1] * away[:, None, 1]) / max(candidate.scale, 0.1)
    return np.concatenate([g, turn[:, :, None], stretch[:, :, None]], axis=2)


def _turned(vectors: Float64Array, angle: Float64Array) -> Float64Array:
    """Vectors (n, 3, k) turned about the vertical by an angle each (n,), rad."""
    c, s = np.cos(angle)[:, None], np.sin(angle)[:, None]
    x, y, z = vectors[:, 0], vectors[:, 1], vectors[:, 2]
    return np.stack([c * x - s * y, s * x + c * y, z], axis=1)


def _log_likelihood(region: Region | None, fit: Fit, share: float, inflation: float) -> float:
    """Of the readings and of what was known before, up to a constant."""
    return -0.5 * (
        share * (fit.chi2 / inflation + fit.log_variance) + fit.offset_chi2 + _prior_chi2(region, fit.candidate)
    )


def _prior_chi2(region: Region | None, candidate: Candidate) -> float:
    if region is None:
        return 0.0
    away = np.array([candidate.x[0] - region.x, candidate.y[0] - region.y])
    place = float(away @ np.linalg.solve(region.cov, away))
    turn = candidate.rotation / region.heading_sd if region.heading_sd > 0.0 else 0.0
    stretch = (candidate.scale - 1.0) / region.scale_sd if region.scale_sd > 0.0 else 0.0
    return place + turn**2 + stretch**2


def _covariance(problem: MatchProblem, fit: Fit, per_reading: float) -> Float64Array:
    """Covariance of the last point, m^2: shift, turn and stretch as field and prior tell them, and the motion's errors.

    Errors that add up along the track leave a third of their last variance when the whole is shifted for the best
    fit (those of a random walk about its mean).
    """
    if fit.candidate.cov is not None:
        return fit.candidate.cov
    region, information = problem.region, fit.information * per_reading
    prior = np.zeros((4, 4))
    if region is not None:
        prior[:2, :2] = np.linalg.inv(region.cov)
    turn_sd, scale_sd = (_TURN_SD, _SCALE_SD) if region is None else (region.heading_sd, region.scale_sd)
    prior[2, 2], prior[3, 3] = max(turn_sd, 1e-6) ** -2, max(scale_sd, 1e-6) ** -2
    posterior = _inverse(information + prior)
    dx, dy = fit.candidate.x[-1] - fit.candidate.x[0], fit.candidate.y[-1] - fit.candidate.y[0]
    jacobian = np.array([[1.0, 0.0, -dy, dx], [0.0, 1.0, dx, dy]])
    cov: Float64Array = jacobian @ posterior @ jacobian.T + problem.track.cov[-1] / 3.0
    return cov


def _shift_covariance(information: Float64Array) -> Float64Array:
    """Covariance of a mere shift, m^2, by the field alone; infinite where it does not tell."""
    shift = information[:2, :2]
    if np.linalg.eigvalsh(shift)[0] <= 1e-12:
        return np.full((2, 2), np.inf)
    return np.asarray(np.linalg.inv(shift), dtype=np.float64)


def _inverse(information: Float64Array) -> Float64Array:
    """Inverse with what is not told at all left as wide as a country, not infinite."""
    return np.asarray(np.linalg.inv(information + np.diag([1e-12, 1e-12, 1e-9, 1e-9])), dtype=np.float64)


def _distinct(
    fits: Sequence[Fit],
    covs: Sequence[Float64Array],
    log: Float64Array,
    cell_m: float,
    policy: JudgementPolicy,
) -> list[int]:
    """Likeliest first, without those that are the same place as a likelier one."""
    kept: list[int] = []
    for i in np.argsort(-log, kind="stable"):
        end = np.array([fits[i].candidate.x[-1], fits[i].candidate.y[-1]])
        for j in kept:
            away = end - (fits[j].candidate.x[-1], fits[j].candidate.y[-1])
            near = float(np.hypot(*away)) <= policy.distinct_cells * cell_m
            if near or float(away @ np.linalg.solve(covs[j], away)) <= policy.distinct_sigmas**2:
                break
        else:
            kept.append(int(i))
    return kept


def _located(candidate: Candidate, cov: Float64Array, weight: float) -> LocatedTrack:
    return LocatedTrack(
        candidate.x, candidate.y, cov, weight, candidate.rotation, candidate.scale, float(candidate.cost)
    )


def _status(matches: Sequence[LocatedTrack], evidence: Evidence, cell_m: float, policy: JudgementPolicy) -> Status:
    if evidence.mapped < policy.mapped:
        return Status.OFF_MAP
    if evidence.residual_rms > policy.explained * evidence.expected_rms:
        return Status.INSUFFICIENT
    if major_axis(matches[0].cov) > policy.settled_cells * cell_m:
        return Status.INSUFFICIENT
    if matches[0].weight >= policy.won:
        return Status.OK
    return Status.AMBIGUOUS if sum(match.weight for match in matches[:5]) >= policy.listed else Status.INSUFFICIENT
