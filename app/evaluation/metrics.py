"""Errors of a replayed walk at its steps, and their summary.

The error at a step is the horizontal distance of the *causal* fix (the newest one not later than the step) to the
truth there. Steps of the first ``GRACE_S`` are not scored.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np
from numpy.typing import NDArray

from app.engine.types import BoolArray, Fix, Float64Array, Prior, Status
from app.evaluation.truth import WalkTruth

ELLIPSE95 = 5.991
"""95 % point of chi-square with two degrees of freedom."""
GRACE_S = 5.0
SAME_TIME_S = 0.05
"""A fix up to this much after the step still counts as the fix of the step."""
_LINEAR = ("x", "y", "cov_xx", "cov_xy", "cov_yy")
NEAR_M = 5.0
WRONG_M = 10.0


@dataclass(frozen=True, slots=True)
class StepScores:
    """One entry per scored step of one walk, shape (n,).

    Attributes
    ----------
    t : s
    travelled : m
        Distance walked since the first label.
    error : m
        NaN where there was neither a fix nor a prior position, infinite where the fix names another level: levels of a
        building need not share a frame, and nobody is helped by the right x and y one storey up.
    answered : bool
        Whether there was a fix.
    inside : bool
        Truth inside the 95 % ellipse, on the right level. False without a fix.
    sure : bool
    level_right : bool
        The fix names the true level. False without a fix.
    located : bool
        The fix claims a position (status other than ``insufficient``).
    """

    t: Float64Array
    travelled: Float64Array
    error: Float64Array
    answered: BoolArray
    inside: BoolArray
    sure: BoolArray
    level_right: BoolArray
    located: BoolArray

    def __len__(self) -> int:
        return int(self.t.shape[0])

    def since(self, row: int) -> StepScores:
        """The steps from ``row`` on."""
        return StepScores(*(getattr(self, name)[row:] for name in self.__dataclass_fields__))


def score_steps(
    truth: WalkTruth,
    fixes: Sequence[Fix],
    *,
    start_t: float,
    level_id: str,
    prior: Prior | None = None,
    grace_s: float = GRACE_S,
) -> StepScores:
    """Score the fixes of one walk at each step later than ``start_t + grace_s``.

    Before the first fix the prior's position, if there is one, stands for it: saying nothing is not a way to a
    better score. A fix that is not a number is no fix.
    """
    rows = np.flatnonzero(truth.t >= start_t + grace_s)
    t = truth.t[rows]
    ordered = sorted((fix for fix in fixes if math.isfinite(fix.x + fix.y)), key=lambda fix: fix.t)
    newest = np.searchsorted([fix.t for fix in ordered], t + SAME_TIME_S, side="right") - 1
    answered = newest >= 0
    error = np.full(len(rows), np.nan)
    if prior is not None and prior.x is not None and prior.y is not None:
        error[:] = np.hypot(prior.x - truth.x[rows], prior.y - truth.y[rows])
    inside, sure, level_right, located = (np.zeros(len(rows), dtype=np.bool_) for _ in range(4))
    if answered.any():
        at = newest[answered]
        dx = np.array([fix.x for fix in ordered])[at] - truth.x[rows[answered]]
        dy = np.array([fix.y for fix in ordered])[at] - truth.y[rows[answered]]
        error[answered] = np.hypot(dx, dy)
        sure[answered] = np.array([fix.sure for fix in ordered])[at]
        level_right[answered] = np.array([fix.level_id == level_id for fix in ordered])[at]
        located[answered] = np.array([fix.status is not Status.INSUFFICIENT for fix in ordered])[at]
        error[answered & ~level_right] = np.inf
        inside[answered] = level_right[answered] & (mahalanobis2(dx, dy, [ordered[i] for i in at]) <= ELLIPSE95)
    return StepScores(t, truth.travelled[rows], error, answered, inside, sure, level_right, located)


def interpolate_fixes(fixes: Sequence[Fix], t: Float64Array) -> tuple[Fix, ...]:
    """A smoothed track at the times ``t``: positions and covariances linear between neighbours, ends held.

    A track after the fact knows what comes next, so it is not scored by its newest fix as a causal one is.
    """
    ordered = sorted((fix for fix in fixes if math.isfinite(fix.x + fix.y)), key=lambda fix: fix.t)
    if not ordered:
        return ()
    own = np.array([fix.t for fix in ordered])
    columns = {name: np.interp(t, own, [getattr(fix, name) for fix in ordered]) for name in _LINEAR}
    nearest = np.abs(own - t[:, None]).argmin(axis=1)
    return tuple(
        replace(ordered[i], t=float(time), **{name: float(column[k]) for name, column in columns.items()})
        for k, (time, i) in enumerate(zip(t, nearest, strict=True))
    )


def mahalanobis2(dx: Float64Array, dy: Float64Array, fixes: Sequence[Fix]) -> Float64Array:
    """Squared Mahalanobis distance of the offsets under the fixes' covariances; inf where one is not positive."""
    xx, xy, yy = (np.array([getattr(fix, name) for fix in fixes]) for name in ("cov_xx", "cov_xy", "cov_yy"))
    determinant = xx * yy - xy**2
    positive = (determinant > 0) & (xx > 0)
    adjugate = yy * dx**2 - 2 * xy * dx * dy + xx * dy**2
    squared: Float64Array = np.where(positive, adjugate / np.where(positive, determinant, 1.0), np.inf)
    return squared


@dataclass(frozen=True, slots=True)
class Summary:
    """The figures a user of the method asks for; None where nothing was scored. Lengths in metres, shares 0 to 1.

    ``p50`` to ``p95`` pool all steps of all walks, ``end_*`` take the last step of each walk; a step on the wrong level
    is farther off than any other, and a quantile among such steps is None. ``mean`` is that of the steps on the right
    level. ``sure_within_5m`` is the share of the steps called sure whose error is at most 5 m (on the right level).
    """

    n_walks: int
    mean: float | None
    p50: float | None
    p75: float | None
    p90: float | None
    p95: float | None
    end_p50: float | None
    end_p90: float | None
    end_within_5m: float | None
    ellipse95: float | None
    sure_share: float | None
    sure_within_5m: float | None
    ms_per_segment: float | None

    def as_dict(self) -> dict[str, int | float | None]:
        """Plain values for JSON, lengths and shares to four decimals."""
        return _plain(self)


def summarize(walks: Sequence[StepScores], segment_s: Sequence[float] = ()) -> Summary:
    """Summary of scored walks and of the wall-clock time per segment, s."""
    errors = np.concatenate([walk.error for walk in walks]) if walks else np.empty(0)
    known = errors[~np.isnan(errors)]
    ends = np.array([walk.error[-1] for walk in walks if len(walk) and not np.isnan(walk.error[-1])])
    answered = _pool(walks, "answered")
    sure = _pool(walks, "sure")
    near = (errors <= NEAR_M) & _pool(walks, "level_right")
    p50, p75, p90, p95 = _quantiles(known, (0.5, 0.75, 0.9, 0.95))
    end_p50, end_p90 = _quantiles(ends, (0.5, 0.9))
    return Summary(
        n_walks=len(walks),
        mean=_mean(known[np.isfinite(known)]),
        p50=p50,
        p75=p75,
        p90=p90,
        p95=p95,
        end_p50=end_p50,
        end_p90=end_p90,
        end_within_5m=_mean(ends <= NEAR_M),
        ellipse95=_mean(_pool(walks, "inside")[answered]),
        sure_share=_mean(sure),
        sure_within_5m=_mean(near[sure]),
        ms_per_segment=_mean(np.array(segment_s) * 1000.0),
    )


@dataclass(frozen=True, slots=True)
class Ends:
    """Where walks end, lengths in metres. A walk that ends without an answer or on the wrong level ends nowhere near.

    ``end_p50`` and ``end_p90`` are None, too, where so many walks end like that.
    """

    n_walks: int
    end_within_5m: float | None
    end_p50: float | None
    end_p90: float | None

    def as_dict(self) -> dict[str, int | float | None]:
        """Plain values for JSON."""
        return _plain(self)


def ends_of(walks: Sequence[StepScores]) -> Ends:
    """Ends of scored walks."""
    last = np.array([walk.error[-1] for walk in walks if len(walk)])
    ends = np.where(np.isnan(last), np.inf, last)
    p50, p90 = _quantiles(ends, (0.5, 0.9))
    return Ends(len(walks), _mean(ends <= NEAR_M), p50, p90)


@dataclass(frozen=True, slots=True)
class Confidence:
    """How soon and how rightly fixes are called sure (asked for in ``cold`` and ``venue``).

    ``first_sure_*`` are medians over the walks that got a sure fix (``n_sure_walks`` of ``n_walks``); the distance is
    walked, the time counted from the first sample. ``sure_wrong_share``: sure steps off by more than 10 m or on the
    wrong level. ``level_hit_rate``: share of the answered steps on the right level; ``end_level_hit_rate`` and
    ``sure_level_hit_rate`` the same of the answered ends and of the sure steps. ``answered_share`` and
    ``located_share``: steps with a fix, and with one that claims a position.
    """

    n_walks: int
    n_sure_walks: int
    first_sure_s: float | None
    first_sure_m: float | None
    sure_wrong_share: float | None
    level_hit_rate: float | None
    end_level_hit_rate: float | None
    sure_level_hit_rate: float | None
    answered_share: float | None
    located_share: float | None

    def as_dict(self) -> dict[str, int | float | None]:
        """Plain values for JSON."""
        return _plain(self)


def confidence(walks: Sequence[StepScores], start_t: Sequence[float]) -> Confidence:
    """How the ``sure`` flags of scored walks did; ``start_t`` is the time of each walk's first sample, s."""
    first = [(walk, t0, int(np.argmax(walk.sure))) for walk, t0 in zip(walks, start_t, strict=True) if walk.sure.any()]
    errors = np.concatenate([walk.error for walk in walks]) if walks else np.empty(0)
    answered, sure = _pool(walks, "answered"), _pool(walks, "sure")
    level_right = _pool(walks, "level_right")
    wrong = (errors > WRONG_M) | ~level_right
    return Confidence(
        n_walks=len(walks),
        n_sure_walks=len(first),
        first_sure_s=_quantiles(np.array([walk.t[i] - t0 for walk, t0, i in first]), (0.5,))[0],
        first_sure_m=_quantiles(np.array([walk.travelled[i] for walk, _, i in first]), (0.5,))[0],
        sure_wrong_share=_mean(wrong[sure]),
        level_hit_rate=_mean(level_right[answered]),
        end_level_hit_rate=_mean(np.array([w.level_right[-1] for w in walks if len(w) and w.answered[-1]], dtype=bool)),
        sure_level_hit_rate=_mean(level_right[sure]),
        answered_share=_mean(answered),
        located_share=_mean(_pool(walks, "located")),
    )


def _pool(walks: Sequence[StepScores], name: str) -> BoolArray:
    if not walks:
        return np.zeros(0, dtype=np.bool_)
    pooled: BoolArray = np.concatenate([getattr(walk, name) for walk in walks])
    return pooled


def _mean(values: NDArray[np.float64] | NDArray[np.bool_]) -> float | None:
    return float(np.mean(values)) if len(values) else None


def _quantiles(values: Float64Array, levels: tuple[float, ...]) -> tuple[float | None, ...]:
    """Quantiles, linear between neighbours, of values that may be infinite; None where one is not finite."""
    ordered = np.sort(values).tolist()
    return tuple(_quantile(ordered, level) for level in levels) if ordered else (None,) * len(levels)


def _quantile(ordered: Sequence[float], level: float) -> float | None:
    position = level * (len(ordered) - 1)
    low = math.floor(position)
    value = ordered[low]
    if position > low and math.isfinite(value):
        value += (position - low) * (ordered[low + 1] - value)
    return value if math.isfinite(value) else None


def _plain(figures: Summary | Ends | Confidence) -> dict[str, int | float | None]:
    return {name: round(value, 4) if isinstance(value, float) else value for name, value in asdict(figures).items()}
