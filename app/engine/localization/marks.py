"""Fixes beside places whose position is known: how large the error was, and whether the claimed ellipse held."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from app.engine.types import Fix, Float64Array, Status

WITHIN_S = 1.0
"""A fix farther in time says nothing about the place: at 1.4 m/s a walker is elsewhere by then."""
CHI2_95 = 5.991
"""95 % quantile of chi-square with two degrees of freedom."""


@dataclass(frozen=True, slots=True)
class Mark:
    """A known position: UTC seconds, level metres, standard deviation per axis (m); no level: whichever it is."""

    t: float
    x: float
    y: float
    level_id: str | None = None
    sd_m: float = 0.0


@dataclass(frozen=True, slots=True)
class MarkMatch:
    """What the fixes said at a mark.

    Attributes
    ----------
    x, y : float, m, level frame
    level_id : str
        Of the fix; another one than the mark's is a miss whatever the distance.
    apart_s : float, s
        Time to the nearest fix that was used.
    error_m : float, m
        Horizontal distance to the mark.
    normalized : float
        Mahalanobis distance under the claimed covariance plus the mark's own; its square is chi-square with two
        degrees of freedom where the claim is true.
    inside : bool
        Whether the mark lies in the 95 % ellipse, on the right level.
    sure : bool
        Whether every fix that was used is.
    status : Status
        Of the nearest fix.
    """

    x: float
    y: float
    level_id: str
    apart_s: float
    error_m: float
    normalized: float
    inside: bool
    sure: bool
    status: Status


def match_mark(mark: Mark, fixes: Sequence[Fix]) -> MarkMatch | None:
    """Compare a mark with the fixes around it; ``fixes`` are of one session, in time order.

    Between two fixes of one level that both lie within :data:`WITHIN_S` position and covariance are interpolated: a
    walker crosses most marks between steps. (The blend of two covariances bounds that of the blend from above, however
    their errors are correlated.) Otherwise the nearest counts; None where none is that near.
    """
    after = next((i for i, fix in enumerate(fixes) if fix.t >= mark.t), len(fixes))
    near = [fix for fix in fixes[max(after - 1, 0) : after + 1] if abs(fix.t - mark.t) <= WITHIN_S]
    if not near:
        return None
    near.sort(key=lambda fix: abs(fix.t - mark.t))
    if len(near) == 2 and near[0].level_id != near[1].level_id:
        near = near[:1]
    weights = _weights(mark.t, near)
    x, y, xx, xy, yy = weights @ np.array([(f.x, f.y, f.cov_xx, f.cov_xy, f.cov_yy) for f in near])
    own = mark.sd_m**2
    distance2 = _mahalanobis2(mark.x - x, mark.y - y, xx + own, xy, yy + own)
    right_level = mark.level_id is None or mark.level_id == near[0].level_id
    return MarkMatch(
        x=float(x),
        y=float(y),
        level_id=near[0].level_id,
        apart_s=abs(near[0].t - mark.t),
        error_m=float(np.hypot(mark.x - x, mark.y - y)),
        normalized=float(np.sqrt(distance2)),
        inside=right_level and distance2 <= CHI2_95,
        sure=all(fix.sure for fix in near),
        status=near[0].status,
    )


def _weights(t: float, near: Sequence[Fix]) -> Float64Array:
    if len(near) == 1 or near[0].t == near[1].t:
        only: Float64Array = np.eye(1, len(near))[0]
        return only
    share = (t - near[0].t) / (near[1].t - near[0].t)
    return np.array([1.0 - share, share])


def _mahalanobis2(dx: float, dy: float, xx: float, xy: float, yy: float) -> float:
    determinant = xx * yy - xy * xy
    if determinant <= 0.0:
        # a claim of no uncertainty at all: true at the very place, false elsewhere
        return 0.0 if dx == dy == 0.0 else 1e12
    return float((yy * dx * dx - 2.0 * xy * dx * dy + xx * dy * dy) / determinant)
