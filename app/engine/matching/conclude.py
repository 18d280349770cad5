"""From what a search found to what may be claimed: one judgement for all matchers.

A search orders placements by its own criterion; whether the best of them is *right* is another question. It is
answered here, for all methods alike: by the likelihood of the readings at each placement, with errors that are
correlated along the track counted once, by what the map's slope tells there, and by what the rest of the region says:
a search that never looked elsewhere cannot claim that there is nothing (:mod:`app.engine.matching.rivals`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from app.engine.matching.field import MapReading, read_map
from app.engine.matching.problem import MatchProblem, Profile, Region, common_features
from app.engine.matching.result import Candidate, Evidence, LocatedTrack, MatchResult
from app.engine.matching.rivals import rival_places
from app.engine.types import FeatureSet, Float64Array, Status

_WALK_ON_M = 5.0
_LISTED = 8
_STEPS = 4
_REGION_CHI2 = 16.0
"""Places beyond four sigma of what is known before are no rivals."""
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
    settled_cells: float = 8.0
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
    score : array, shape (4,)
        Of the same four: what the residuals ask for.
    reading : MapReading
    """

    candidate: Candidate
    residual: Float64Array
    variance: Float64Array
    chi2: float
    log_variance: float
    offset_chi2: float
    information: Float64Array
    score: Float64Array
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
    profile = problem.profile.as_features(features)
    fits = [fit_candidate(problem, one, profile) for one in candidates]
    best = min(fits, key=lambda fit: fit.chi2)
    share = min(independent_share(best.residual / np.sqrt(best.variance)), _share_of_map(problem, best))
    # What the best place leaves unexplained is error of some kind: without it, many readings would be sure of anything.
    inflation = max(1.0, best.chi2 / best.residual.size)
    log = np.array([_log_likelihood(problem.region, fit, share, inflation) for fit in fits])
    covs = [_covariance(problem, fit, share / inflation) for fit in fits]
    kept = _distinct(fits, covs, log, problem.grid_map.cell_m, policy)
    named = [(fits[i].candidate, covs[i]) for i in kept]
    places, elsewhere = list(log[kept]), []
    for fit, place in rival_fits(problem, profile, named, policy, share=share, inflation=inflation):
        likelihood = _log_likelihood(problem.region, fit, share, inflation)
        if place is None:
            elsewhere.append(likelihood)
        else:
            places[place] = max(places[place], likelihood)
    everywhere = np.array([*places, *elsewhere])
    weight = np.exp(places - everywhere.max()) / np.exp(everywhere - everywhere.max()).sum()
    order = np.argsort(-weight, kind="stable")
    kept, weight = [kept[i] for i in order], weight[order]
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
    told = float(np.linalg.eigvalsh(first.information[:2, :2])[-1]) * (share / inflation)
    # without any slope in any direction a placement rests on what was known before, whatever the search made of noise
    silent = told * (policy.settled_cells * problem.grid_map.cell_m) ** 2 < 1.0
    status = Status.INSUFFICIENT if silent else _status(matches, evidence, problem.grid_map.cell_m, policy)
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
        score=np.einsum("nci,nc->i", weighted, residual),
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


def _share_of_map(problem: MatchProblem, fit: Fit) -> float:
    """Part of the readings that counts where the map itself errs: its errors change over the distance to its samples.

    Residuals do not show this once a track has been bent to fit them. Between samples ``d`` apart, kriging errs alike
    over about half of that, which is twice the mean distance to the nearest sample.
    """
    n = len(problem)
    length_m = 2.0 * float(fit.reading.support.mean())
    if n < 2 or length_m <= 0.0:
        return 1.0
    rho = float(np.exp(-problem.track.length_m / (n - 1) / length_m))
    of_map = min(float((fit.reading.sd**2).mean() / fit.variance.mean()), 1.0)
    return 1.0 / ((1.0 - of_map) + of_map * (1.0 + rho) / max(1.0 - rho, 1e-6))


def rival_fits(
    problem: MatchProblem,
    profile: Profile,
    known: Sequence[tuple[Candidate, Float64Array]],
    policy: JudgementPolicy,
    *,
    share: float,
    inflation: float,
) -> list[tuple[Fit, int | None]]:
    """The likeliest places of the region, each with the index in ``known`` of the place that it is, or None.

    ``known`` are the places that the search named, with their covariances. Rivals are shifted, turned and stretched to
    their best, as a search would have done.
    """
    region, cell_m = problem.region, problem.grid_map.cell_m
    shapes = [Candidate(problem.track.x, problem.track.y, np.nan)]  # as indicated, and as the search bent it
    if region is None or _prior_chi2(region, _begun_at(region, known[0][0])) <= _REGION_CHI2:
        shapes.append(known[0][0])
    found: list[tuple[Fit, int | None]] = []
    for place in (place for shape in shapes for place in rival_places(problem, profile, shape)):
        if region is not None and _prior_chi2(region, place) > _REGION_CHI2:
            continue
        fit = _settled(problem, profile, fit_candidate(problem, place, profile), share, inflation)
        end = np.array([fit.candidate.x[-1], fit.candidate.y[-1]])
        same = (i for i, (one, cov) in enumerate(known) if _same_place(end, one, cov, cell_m, policy))
        found.append((fit, next(same, None)))
    return found


def _begun_at(region: Region, candidate: Candidate) -> Candidate:
    """The same shape from the region's centre: what is left of its prior is that of turn and stretch."""
    x, y = candidate.x - candidate.x[0] + region.x, candidate.y - candidate.y[0] + region.y
    return replace(candidate, x=x, y=y)


def _settled(problem: MatchProblem, profile: Profile, fit: Fit, share: float, inflation: float) -> Fit:
    """A placement after some Gauss-Newton steps over shift, turn and stretch, as long as they bear fruit."""
    log = _log_likelihood(problem.region, fit, share, inflation)
    for _ in range(_STEPS):
        prior, pull = _prior_terms(problem.region, fit.candidate)
        per_reading = share / inflation
        step = np.linalg.solve(fit.information * per_reading + prior + 1e-9 * np.eye(4), fit.score * per_reading - pull)
        moved = fit_candidate(problem, _moved(fit.candidate, step), profile)
        now = _log_likelihood(problem.region, moved, share, inflation)
        if not now > log:
            break
        fit, log = moved, now
    return fit


def _moved(candidate: Candidate, step: NDArray[np.floating]) -> Candidate:
    """The placement shifted, turned about its first point and stretched by a step of (m, m, rad, -)."""
    turn, stretch = float(np.clip(step[2], -0.3, 0.3)), 1.0 + float(np.clip(step[3], -0.2, 0.2))
    c, s = stretch * np.cos(turn), stretch * np.sin(turn)
    x, y = candidate.x - candidate.x[0], candidate.y - candidate.y[0]
    return replace(
        candidate,
        x=candidate.x[0] + step[0] + c * x - s * y,
        y=candidate.y[0] + step[1] + s * x + c * y,
        rotation=candidate.rotation + turn,
        scale=candidate.scale * stretch,
    )


def _prior_terms(region: Region | None, candidate: Candidate) -> tuple[Float64Array, Float64Array]:
    """Information (4, 4) and pull (4,) of what was known before, about shift, turn and stretch."""
    information, pull = np.zeros((4, 4)), np.zeros(4)
    turn_sd, scale_sd = (_TURN_SD, _SCALE_SD) if region is None else (region.heading_sd, region.scale_sd)
    information[2, 2], information[3, 3] = max(turn_sd, 1e-6) ** -2, max(scale_sd, 1e-6) ** -2
    pull[2:] = information[2, 2] * candidate.rotation, information[3, 3] * (candidate.scale - 1.0)
    if region is not None:
        information[:2, :2] = np.linalg.inv(region.cov)
        pull[:2] = information[:2, :2] @ (candidate.x[0] - region.x, candidate.y[0] - region.y)
    return information, pull


def _same_place(end: Float64Array, known: Candidate, cov: Float64Array, cell_m: float, policy: JudgementPolicy) -> bool:
    """Whether a track that ends there is the known one, give or take its uncertainty."""
    away = end - (known.x[-1], known.y[-1])
    near = float(np.hypot(*away)) <= policy.distinct_cells * cell_m
    return near or float(away @ np.linalg.solve(cov, away)) <= policy.distinct_sigmas**2


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
        share * ((fit.chi2 + fit.candidate.bending) / inflation + fit.log_variance)
        + fit.offset_chi2
        + _prior_chi2(region, fit.candidate)
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
    prior, _ = _prior_terms(problem.region, fit.candidate)
    posterior = _inverse(fit.information * per_reading + prior)
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
        if not any(_same_place(end, fits[j].candidate, covs[j], cell_m, policy) for j in kept):
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
