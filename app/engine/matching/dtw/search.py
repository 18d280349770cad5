"""Costs of all places of a library, and the few best of them."""

from __future__ import annotations

import time
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from app.engine.kernels.dtw import classic_subsequence, classic_windows, skipping_subsequence, skipping_windows
from app.engine.kernels.lanes import FAR, LANES
from app.engine.matching.dtw.bands import Band
from app.engine.matching.dtw.library import Library, into_lanes, out_of_lanes
from app.engine.types import BoolArray, Float64Array

_BLOCK_CELLS = 5e7
"""Cells between two looks at the clock: about ten milliseconds."""


class Steps(StrEnum):
    """Which pairs a warping path may go on to.

    * ``classic``: either sequence, or both, go on by one point.
    * ``skipping``: the query goes on by one point, the route by none, one or two.
    """

    CLASSIC = "classic"
    SKIPPING = "skipping"


class Deadline:
    """Processor time of this thread that a search may still use."""

    def __init__(self, seconds: float | None) -> None:
        self._until = None if seconds is None else time.thread_time() + seconds

    @property
    def passed(self) -> bool:
        """Whether it is over."""
        return self._until is not None and time.thread_time() >= self._until


@dataclass(frozen=True, slots=True)
class Costs:
    """Cost of the best warping at each point of a library: sum of squared differences, uT^2.

    Attributes
    ----------
    total : array, shape (m,)
        Infinite where there is none or it was not looked at.
    complete : bool
        Whether the deadline left time for all.
    """

    total: Float64Array
    complete: bool

    @property
    def evaluated(self) -> int:
        """Places that were looked at."""
        return int(np.isfinite(self.total).sum())


def window_means(values: Float64Array, valid: BoolArray, n: int) -> Float64Array:
    """Mean of the ``n`` points from each valid one on, zero at others, shape (m, channels)."""
    clean = np.where(np.abs(values) < 1e4, values, 0.0)  # a running sum must not carry what stands between routes
    total = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(clean, axis=0)])
    means = np.zeros_like(values)
    first = np.flatnonzero(valid)
    means[first] = (total[first + n] - total[first]) / n
    return means


def window_costs(
    query: Float64Array, library: Library, band: Band, steps: Steps, *, centred: bool, deadline: Deadline
) -> Costs:
    """Query against the window of its own length that begins at each point.

    Parameters
    ----------
    query : array, shape (n, channels), uT
    library : Library
    band : Band
    steps : Steps
    centred : bool
        Compare both less their means.
    deadline : Deadline
    """
    n, channels = query.shape
    kernel = classic_windows if steps is Steps.CLASSIC else skipping_windows
    valid = library.runs(n)
    lanes, step = into_lanes(library.values, 0, n)
    x, q, shift = lanes.astype(np.float32), query.astype(np.float32), None
    if centred:
        means, _ = into_lanes(window_means(library.values, valid, n), 0, n, fill=0.0)
        q, shift = (query - query.mean(axis=0)).astype(np.float32), means.astype(np.float32)
    row = np.empty((n + 2, LANES), dtype=np.float32)
    out = np.full((step, LANES), np.inf, dtype=np.float32)
    block = max(int(_BLOCK_CELLS / (LANES * n * n * channels)), 1)
    g = 0
    while g < step and not deadline.passed:
        e = min(g + block, step)
        moved = None if shift is None else shift[g:e]
        kernel(q, x[g:], 1, n, *band, (0,) * channels, moved, row, out[g:e])
        g = e
    total = out_of_lanes(out.astype(np.float64), len(library))
    return Costs(np.where(valid, total, np.inf), g == step)


def subsequence_costs(
    query: Float64Array, library: Library, steps: Steps, *, uneven: float, deadline: Deadline
) -> Costs:
    """Query against all stretches that end at each point, wherever they begin.

    With classic steps, a stretch more than twice as long as the query may be missed.

    Parameters
    ----------
    query : array, shape (n, channels), uT
    library : Library
    steps : Steps
    uneven : float, uT^2
        Cost of a skipping step by which the route does not go on by exactly one point.
    deadline : Deadline
    """
    n, channels = query.shape
    lanes, _ = into_lanes(library.values, 2 * n, 0)
    x, q = lanes.astype(np.float32), query.astype(np.float32)
    state = np.full((n, LANES) if steps is Steps.CLASSIC else (n, 2, LANES), FAR["float32"])
    out = np.full((len(x), LANES), np.inf, dtype=np.float32)
    block = 2 * max(int(_BLOCK_CELLS / (2 * LANES * n * channels)), 1)
    j = 0
    while j < len(x) and not deadline.passed:
        e = min(j + block, len(x))
        if steps is Steps.CLASSIC:
            classic_subsequence(q, x[j:e], (0,) * channels, state, out[j:e])
        else:
            skipping_subsequence(q, x[j:e], (0,) * channels, np.float32(uneven), state, out[j:e])
        j = e
    total = out_of_lanes(out[2 * n :].astype(np.float64), len(library))
    return Costs(np.where((library.route >= 0) & (total < FAR["float32"]), total, np.inf), j == len(x))


def best_places(total: Float64Array, library: Library, *, places: int, separation_m: float) -> list[int]:
    """The cheapest local minima, each at least ``separation_m`` from a cheaper one of its route and direction."""
    padded = np.concatenate([[np.inf], total, [np.inf]])
    lowest = np.where((total <= padded[:-2]) & (total <= padded[2:]), total, np.inf)
    reach = max(round(separation_m / library.spacing_m), 1)
    found: list[int] = []
    while len(found) < places:
        j = int(np.argmin(lowest))
        if not np.isfinite(lowest[j]):
            break
        found.append(j)
        near = slice(max(j - reach, 0), j + reach + 1)
        lowest[near] = np.where(library.route[near] == library.route[j], np.inf, lowest[near])
    return found
