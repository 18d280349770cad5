"""What a fix may claim: status, quality, and whether it is sure."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from app.engine.filtering import Estimate
from app.engine.types import Status

CHI2_95 = 5.991
"""95 % quantile of chi-square with two degrees of freedom: scale of the ellipse."""


@dataclass(frozen=True, slots=True)
class IntegrityPolicy:
    """Thresholds, fitted on survey walks against maps that do not hold them.

    Attributes
    ----------
    covariance_scale, covariance_floor : float, -, m^2
        Applied to the particles' covariance so that the 95 % ellipse holds what it claims.
    cold_scale : float
        Further factor while the start is searched: a cloud narrows faster than it learns.
    smoothed_scale : float
        Further factor for smoothed fixes: the lines of particles merge going back.
    settle_m : float
        A spread (major semi-axis, one sigma) below this counts as one place.
    insufficient_m : float
        Above this nothing is claimed.
    sure_m : float
        Major semi-axis (one sigma) up to which a fix is sure.
    off_map_share : float
        Below this share of particles on mapped ground (smoothed over ``memory_m``) the position rests on motion alone.
    memory_m : float
    search_m : float
        A place known only to this radius after a gap has to be searched: the session counts as one with unknown start.
    information_m : float
        Metres of walk that usually settle a start.
    """

    covariance_scale: float = 1.0
    covariance_floor: float = 0.3
    cold_scale: float = 4.0
    smoothed_scale: float = 1.5
    settle_m: float = 5.0
    insufficient_m: float = 8.0
    sure_m: float = 2.2
    off_map_share: float = 0.35
    memory_m: float = 4.0
    search_m: float = 8.0
    information_m: float = 30.0


@dataclass(frozen=True, slots=True)
class Integrity:
    """Running account of a session.

    Attributes
    ----------
    cold : bool
        The start was unknown. A cloud that has narrowed from everywhere may have narrowed onto the wrong place, and
        nothing in it can tell; its fixes stay ambiguous.
    walked_m : float
    mapped : float
        Share of particles on mapped ground, smoothed.
    settled : bool
        Whether the spread has been that of one place.
    """

    cold: bool = False
    walked_m: float = 0.0
    mapped: float = 1.0
    settled: bool = False

    def resumed(self, reach_m: float, policy: IntegrityPolicy) -> Integrity:
        """After a gap in which the walker may have gone ``reach_m``; far enough, and the start is unknown again."""
        return replace(self, walked_m=0.0, settled=False, cold=self.cold or reach_m > policy.search_m)

    def walked(self, stride: float, estimate: Estimate, policy: IntegrityPolicy) -> Integrity:
        """After one more step."""
        keep = float(np.exp(-stride / policy.memory_m))
        return replace(
            self,
            walked_m=self.walked_m + stride,
            mapped=keep * self.mapped + (1.0 - keep) * estimate.mapped,
            settled=self.settled or spread(estimate) < policy.settle_m,
        )


def calibrate(estimate: Estimate, integrity: Integrity, policy: IntegrityPolicy) -> tuple[float, float, float]:
    """Covariance (xx, xy, yy) that a fix claims, m^2."""
    scale, floor = policy.covariance_scale, policy.covariance_floor
    if integrity.cold:
        scale *= policy.cold_scale
    return scale * estimate.cov_xx + floor, scale * estimate.cov_xy, scale * estimate.cov_yy + floor


@dataclass(frozen=True, slots=True)
class Verdict:
    """What the fix claims."""

    status: Status
    quality: float
    sure: bool
    walk_on_m: float | None


def spread(estimate: Estimate) -> float:
    """Major semi-axis of the covariance, one sigma, m."""
    half_trace = 0.5 * (estimate.cov_xx + estimate.cov_yy)
    half_difference = 0.5 * (estimate.cov_xx - estimate.cov_yy)
    return float(np.sqrt(max(half_trace + np.hypot(half_difference, estimate.cov_xy), 0.0)))


def judge(estimate: Estimate, integrity: Integrity, policy: IntegrityPolicy) -> Verdict:
    """Status, quality and sureness of an estimate."""
    sigma = spread(estimate)
    quality = float(1.0 / (1.0 + (sigma / 3.0) ** 2))
    if sigma > policy.insufficient_m or not integrity.settled:
        missing = max(policy.information_m - integrity.walked_m, 5.0)
        return Verdict(Status.INSUFFICIENT, quality, sure=False, walk_on_m=missing)
    if integrity.cold:
        return Verdict(Status.AMBIGUOUS, quality * 0.5, sure=False, walk_on_m=None)
    if integrity.mapped < policy.off_map_share:
        return Verdict(Status.OFF_MAP, quality * 0.5, sure=False, walk_on_m=None)
    return Verdict(Status.OK, quality, sigma <= policy.sure_m, walk_on_m=None)
