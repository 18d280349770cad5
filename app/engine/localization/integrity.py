"""What a fix may claim: status, quality, and whether it is sure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from app.engine.filtering import Estimate, Mode
from app.engine.localization.search import Belief, Place
from app.engine.types import Fix, FixKind, Hypothesis, Status

CHI2_95 = 5.991
"""95 % quantile of chi-square with two degrees of freedom: scale of the ellipse."""
WALK_ON_M = 5.0
"""Nobody is asked to walk on less than this."""
MAX_HYPOTHESES = 5


@dataclass(frozen=True, slots=True)
class IntegrityPolicy:
    """Thresholds, fitted on survey walks against maps that do not hold them.

    Attributes
    ----------
    covariance_scale, covariance_floor : float, -, m^2
        Applied to the particles' covariance so that the 95 % ellipse holds what it claims.
    searched_scale : float
        Further factor while the place is searched with more than the field, and for a place just found: the search's
        likelihood is sharper than readings are, and what radio maps err by is alike for many transmitters.
    found_scale : float
        Further factor for a track from a place that was found: of all places it was the one that fitted best, and a
        place some metres beside the right one goes on fitting.
    found_misfit : float, nats per step
        Misfit at which that factor has doubled; it grows with the square.
    credit_bias, credit_slope : float
        Log odds of a place being right: this and so many times the log odds of its share of a search's belief.
    handover_m : float, m
        Standard deviation added to particles when tracking takes over from the search, for the same reason.
    lagged_scale, smoothed_scale : float
        Further factors for the particles' covariance of fixed-lag and of smoothed fixes: lines merge going back, the
        farther the more.
    settle_m : float
        A spread (major semi-axis, one sigma) below this counts as one place.
    insufficient_m : float
        Above this nothing is claimed.
    sure_m : float
        Major semi-axis (one sigma, widened by how the place was found) up to which a fix is sure.
    off_map_share : float
        Below this share of particles on mapped ground (smoothed over ``memory_m``) the position rests on motion alone.
    disturbed_share : float
        From this share of disturbed steps on (smoothed over ``memory_m``) the field tells nothing of the place.
    memory_m : float
    search_m : float
        A start known only to this radius, also after a gap, has to be searched.
    listed : float
        Share of the belief that the listed places must hold for a fix to be called ambiguous; below it is insufficient.
    found : float
        Share of the belief that one place must hold to be taken for the right one.
    found_steps : int
        For so many steps on end.
    found_log, found_slack : float, nats and nats per m
        Log odds that it must have besides, which rise with the way: what map and walk err by alike adds up along it, so
        that a wrong place may win by more the longer it is searched.
    open_level : float
        Times ``found_slack`` where several levels are searched by the field alone: each errs in its own way. A place
        found so is sure only once a check of the steps that follow has borne it out.
    found_m : float
        Metres that must have been walked by then.
    """

    covariance_scale: float = 1.1
    covariance_floor: float = 0.3
    searched_scale: float = 10.0
    found_scale: float = 2.0
    found_misfit: float = 0.3
    credit_bias: float = -1.2
    credit_slope: float = 0.53
    handover_m: float = 1.5
    lagged_scale: float = 1.2
    smoothed_scale: float = 1.5
    settle_m: float = 5.0
    insufficient_m: float = 8.0
    sure_m: float = 2.2
    off_map_share: float = 0.35
    disturbed_share: float = 0.5
    memory_m: float = 4.0
    search_m: float = 8.0
    listed: float = 0.8
    found: float = 0.999
    found_steps: int = 7
    found_m: float = 25.0
    found_log: float = 3.0
    found_slack: float = 0.15
    open_level: float = 2.0


@dataclass(frozen=True, slots=True)
class Integrity:
    """Running account of a session.

    Attributes
    ----------
    walked_m : float
    mapped : float
        Share of particles on mapped ground, smoothed.
    settled : bool
        Whether the spread has been that of one place.
    disturbed : float
        Share of steps whose field was disturbed, smoothed.
    doubted : bool
        Whether the newest steps fit better elsewhere (see :mod:`app.engine.localization.lost`).
    borne_out : bool
        Whether newest steps have been found to fit better here than elsewhere. Until then a prior is all there is.
    found : bool
        Whether the place was found by a search, not told by a prior.
    misfit : float, nats per step
        How badly the newest steps are explained (see :mod:`app.engine.localization.lost`).
    """

    walked_m: float = 0.0
    mapped: float = 1.0
    settled: bool = False
    disturbed: float = 0.0
    doubted: bool = False
    borne_out: bool = False
    found: bool = False
    misfit: float = 0.0

    def away(self) -> Integrity:
        """On another level than the map's."""
        return replace(self, mapped=0.0)

    def resumed(self) -> Integrity:
        """After a gap."""
        return replace(self, walked_m=0.0, settled=False, doubted=False)

    def walked(
        self, stride: float, estimate: Estimate, policy: IntegrityPolicy, *, disturbed: bool = False
    ) -> Integrity:
        """After one more step."""
        keep = float(np.exp(-stride / policy.memory_m))
        return replace(
            self,
            walked_m=self.walked_m + stride,
            mapped=keep * self.mapped + (1.0 - keep) * estimate.mapped,
            settled=self.settled or spread(estimate) < policy.settle_m,
            disturbed=keep * self.disturbed + (1.0 - keep) * disturbed,
        )


def calibrate(
    estimate: Estimate | Mode, policy: IntegrityPolicy, factor: float = 1.0, *, widen: float = 1.0
) -> tuple[float, float, float]:
    """Covariance (xx, xy, yy) that a fix claims, m^2; ``factor`` multiplies the policy's, ``widen`` its scale only."""
    scale, floor = widen * factor * policy.covariance_scale, factor * policy.covariance_floor
    return scale * estimate.cov_xx + floor, scale * estimate.cov_xy, scale * estimate.cov_yy + floor


@dataclass(frozen=True, slots=True)
class Verdict:
    """What the fix claims."""

    status: Status
    quality: float
    sure: bool
    walk_on_m: float | None


def spread(estimate: Estimate | Mode) -> float:
    """Major semi-axis of the covariance, one sigma, m."""
    half_trace = 0.5 * (estimate.cov_xx + estimate.cov_yy)
    half_difference = 0.5 * (estimate.cov_xx - estimate.cov_yy)
    return float(np.sqrt(max(half_trace + np.hypot(half_difference, estimate.cov_xy), 0.0)))


def judge(estimate: Estimate, integrity: Integrity, policy: IntegrityPolicy) -> Verdict:
    """Status, quality and sureness of an estimate."""
    sigma = spread(estimate)
    claimed = sigma * np.sqrt(_widening(integrity, policy))
    quality = float(1.0 / (1.0 + (claimed / 3.0) ** 2))
    if sigma > policy.insufficient_m or not integrity.settled:
        return Verdict(Status.INSUFFICIENT, quality, sure=False, walk_on_m=max(sigma, WALK_ON_M))
    if integrity.mapped < policy.off_map_share:
        return Verdict(Status.OFF_MAP, quality * 0.5, sure=False, walk_on_m=None)
    if integrity.disturbed > policy.disturbed_share:
        return Verdict(Status.DISTURBED, quality * 0.5, sure=False, walk_on_m=None)
    if integrity.doubted:
        return Verdict(Status.AMBIGUOUS, quality * 0.5, sure=False, walk_on_m=max(sigma, WALK_ON_M))
    return Verdict(Status.OK, quality, bool(claimed <= policy.sure_m) and integrity.borne_out, walk_on_m=None)


def _widening(integrity: Integrity, policy: IntegrityPolicy) -> float:
    """Factor of the covariance for how the place came to be known.

    A track that began beside the right place shows it by its fit, long before another place fits better.
    """
    misfit = max(integrity.misfit, 0.0) / policy.found_misfit
    return policy.found_scale * (1.0 + misfit**2) if integrity.found else 1.0


def tell(
    t: float,
    level_id: str,
    estimate: Estimate,
    integrity: Integrity,
    policy: IntegrityPolicy,
    *,
    kind: FixKind = FixKind.FILTERED,
) -> Fix:
    """Fix of a step at ``t`` while the place is known; ``estimate`` and ``integrity`` are the step's."""
    widen = {FixKind.FILTERED: 1.0, FixKind.FIXED_LAG: policy.lagged_scale, FixKind.SMOOTHED: policy.smoothed_scale}
    covariance = calibrate(estimate, policy, widen=widen[kind] * _widening(integrity, policy))
    verdict = judge(estimate, integrity, policy)
    return _fix(t, level_id, estimate, covariance, verdict, heading=estimate.heading, kind=kind)


def _fix(
    t: float,
    level_id: str,
    at: Estimate | Mode,
    covariance: tuple[float, float, float],
    verdict: Verdict,
    *,
    heading: float,
    kind: FixKind = FixKind.FILTERED,
) -> Fix:
    """A fix at the mean of ``at``, with the covariance (xx, xy, yy, m^2) that is claimed."""
    cov_xx, cov_xy, cov_yy = covariance
    return Fix(
        t=t,
        level_id=level_id,
        x=at.x,
        y=at.y,
        cov_xx=cov_xx,
        cov_xy=cov_xy,
        cov_yy=cov_yy,
        heading=heading,
        status=verdict.status,
        quality=verdict.quality,
        sure=verdict.sure,
        walk_on_m=verdict.walk_on_m,
        kind=kind,
    )


def confirmed(beliefs: Sequence[Belief], walked_m: float, policy: IntegrityPolicy) -> bool:
    """Whether one place has carried enough of the belief for long enough to be taken for the right one.

    ``beliefs`` are those after each of the last steps, newest last.
    """
    held = [belief.places[0].mode for belief in beliefs[-policy.found_steps :]]
    slack = (policy.open_level if beliefs[-1].level_open else 1.0) * policy.found_slack
    return (
        walked_m >= policy.found_m
        and len(held) >= policy.found_steps
        and min(mode.weight for mode in held) >= policy.found
        and min(_log_odds(mode.weight) for mode in held) >= policy.found_log + slack * walked_m
        and spread(held[-1]) < policy.settle_m
    )


def search_fix(
    t: float, beliefs: Sequence[Belief], walked_m: float, policy: IntegrityPolicy, *, hypotheses: bool = False
) -> Fix:
    """Fix while the place is searched: the heaviest place, what is claimed of it, and on request the other places.

    ``beliefs`` are those after each of the last steps up to this one. Until one place is confirmed, the covariance is
    about the first place and holds all others; what the hypotheses' weights lack of one is for places not named.
    """
    belief = beliefs[-1]
    places, e = belief.places, belief.estimate
    first, credit = places[0].mode, 1.0
    if confirmed(beliefs, walked_m, policy):
        sigma = spread(first)
        verdict = Verdict(
            Status.OK,
            first.weight / (1.0 + (sigma / 3.0) ** 2),
            sure=False,  # the places that it beat are those that it could think of: the steps that follow decide
            walk_on_m=None,
        )
        covariance = calibrate(first, policy, policy.searched_scale)
    else:
        credit = 1.0 if belief.start is None else credible(first.weight, policy) / first.weight
        covariance = _searched(belief, policy)
        short_list = walked_m >= 0.5 * policy.found_m and sum(place.mode.weight for place in places) >= policy.listed
        status = Status.AMBIGUOUS if short_list else Status.INSUFFICIENT
        missing = max(belief.walk_on_m, policy.found_m - walked_m, WALK_ON_M)
        verdict = Verdict(status, 0.5 * credit * first.weight, sure=False, walk_on_m=missing)
    fix = _fix(t, places[0].level_id, first, covariance, verdict, heading=e.heading)
    told = tuple(_hypothesis(place, credit) for place in places[:MAX_HYPOTHESES]) if hypotheses else ()
    return replace(fix, hypotheses=told)


def credible(weight: float, policy: IntegrityPolicy) -> float:
    """What a place with this share of a search's belief may be believed, by the field alone.

    A search compares places by their maps and can only guess at ground that nobody surveyed. Where a walk was surveyed
    throughout, the share of the belief is how often the place is right; over all walks it is right less often.
    """
    right = 1.0 / (1.0 + np.exp(-policy.credit_bias - policy.credit_slope * _log_odds(weight)))
    return min(float(right), weight)


def _log_odds(weight: float) -> float:
    """Of a share of the belief, as far as single precision tells it from all."""
    weight = min(max(weight, 1e-7), 1.0 - 1e-7)
    return float(np.log(weight / (1.0 - weight)))


def _searched(belief: Belief, policy: IntegrityPolicy) -> tuple[float, float, float]:
    """Covariance about the first place: of all particles as far as it is credible, for the rest of where the walk may
    have begun. With other evidence than the field, that of the particles, wider than they say."""
    first = belief.places[0].mode
    about = _about(belief.estimate, first)
    if belief.start is None:
        return calibrate(about, policy, policy.searched_scale)
    share, anywhere = credible(first.weight, policy), _about(belief.start, first)
    mixed = replace(
        first,
        cov_xx=share * about.cov_xx + (1.0 - share) * anywhere.cov_xx,
        cov_xy=share * about.cov_xy + (1.0 - share) * anywhere.cov_xy,
        cov_yy=share * about.cov_yy + (1.0 - share) * anywhere.cov_yy,
    )
    return calibrate(mixed, policy)


def _about(moments: Estimate | Mode, place: Mode) -> Mode:
    """Second moments about a place."""
    dx, dy = moments.x - place.x, moments.y - place.y
    return replace(
        place, cov_xx=moments.cov_xx + dx * dx, cov_xy=moments.cov_xy + dx * dy, cov_yy=moments.cov_yy + dy * dy
    )


def _hypothesis(place: Place, credit: float) -> Hypothesis:
    """The place as it is told; ``credit`` is what is left of its share of the belief."""
    m = place.mode
    return Hypothesis(place.level_id, m.x, m.y, m.cov_xx, m.cov_xy, m.cov_yy, credit * m.weight)
