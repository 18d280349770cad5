"""Two sets of fixes of one trip side by side, told by two maps or two methods."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from app.engine.types import Fix, Status

_DIGITS = 6
"""Fixes of one time are compared; microseconds are as fine as a float64 of seconds is."""


@dataclass(frozen=True, slots=True)
class Distances:
    """Distances of ``n`` pairs of fixes, m; the largest, and what half and 90 % stay below."""

    n: int
    p50: float
    p90: float
    largest: float


@dataclass(frozen=True, slots=True)
class FixComparison:
    """What was told then and what is told now.

    Attributes
    ----------
    n_then, n_now : int
        Fixes of either.
    n_compared : int
        Pairs of one time.
    n_other_level : int
        Pairs on different levels: they have no distance.
    distance, sure_distance : Distances or None
        Between the positions of pairs on one level, and of those where both are sure; None without any.
    status_then, status_now : mapping of Status to float
        Shares of the fixes, 0 to 1; a status that no fix has is left out.
    sure_then, sure_now : float
        Share of sure fixes, 0 to 1.
    """

    n_then: int
    n_now: int
    n_compared: int
    n_other_level: int
    distance: Distances | None
    sure_distance: Distances | None
    status_then: Mapping[Status, float]
    status_now: Mapping[Status, float]
    sure_then: float
    sure_now: float


def compare_fixes(then: Sequence[Fix], now: Sequence[Fix]) -> FixComparison:
    """Compare fixes of one trip, pair by pair where their times agree."""
    by_time = {round(fix.t, _DIGITS): fix for fix in then}
    pairs = [(by_time[key], fix) for fix in now if (key := round(fix.t, _DIGITS)) in by_time]
    same = [pair for pair in pairs if pair[0].level_id == pair[1].level_id]
    return FixComparison(
        n_then=len(then),
        n_now=len(now),
        n_compared=len(pairs),
        n_other_level=len(pairs) - len(same),
        distance=_distances(same),
        sure_distance=_distances([pair for pair in same if pair[0].sure and pair[1].sure]),
        status_then=_shares(then),
        status_now=_shares(now),
        sure_then=_sure(then),
        sure_now=_sure(now),
    )


def _distances(pairs: Sequence[tuple[Fix, Fix]]) -> Distances | None:
    if not pairs:
        return None
    apart = np.array([np.hypot(b.x - a.x, b.y - a.y) for a, b in pairs])
    p50, p90 = np.percentile(apart, (50, 90))
    return Distances(len(pairs), float(p50), float(p90), float(apart.max()))


def _shares(fixes: Sequence[Fix]) -> dict[Status, float]:
    counts = Counter(fix.status for fix in fixes)
    return {status: counts[status] / len(fixes) for status in Status if counts[status]}


def _sure(fixes: Sequence[Fix]) -> float:
    return sum(fix.sure for fix in fixes) / len(fixes) if fixes else 0.0
