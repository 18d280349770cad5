"""Which pairs of query and window a warping may match: first and last position for each point of the query."""

from __future__ import annotations

import numpy as np

from app.engine.types import IntArray

Band = tuple[IntArray, IntArray]
"""``lo``, ``hi``, shape (n,) each: both ends included, neither ever falls."""


def full_band(n: int, m: int) -> Band:
    """All pairs."""
    return np.zeros(n, dtype=np.int64), np.full(n, m - 1, dtype=np.int64)


def sakoe_chiba_band(n: int, m: int, radius: int) -> Band:
    """Pairs at most ``radius`` positions off the diagonal from the first pair to the last.

    Sakoe and Chiba 1978, doi:10.1109/TASSP.1978.1163055, with the diagonal of unequal lengths in place of ``i = j``;
    the radius is no smaller than a step of that diagonal, so that the band always holds a path.
    """
    centre = np.arange(n) * ((m - 1) / max(n - 1, 1))
    reach = max(radius, int(np.ceil((m - 1) / max(n - 1, 1))))
    lo = np.maximum(np.ceil(centre - reach), 0).astype(np.int64)
    hi = np.minimum(np.floor(centre + reach), m - 1).astype(np.int64)
    lo[0], hi[-1] = 0, m - 1
    return lo, hi


def itakura_band(n: int, m: int) -> Band | None:
    """Pairs inside the parallelogram whose sides have slopes 1/2 and 2; None where it holds no path.

    Where the lengths differ, only skipping steps are sure to find a path through it.

    Itakura 1975, doi:10.1109/TASSP.1975.1162641. The upper side must come down to the last pair, which the edge printed
    by Zhang 2021 (Hangzhou Dianzi University), equation 3.5, does not.
    """
    if 2 * (m - 1) < n - 1 or m - 1 > 2 * (n - 1):
        return None
    i = np.arange(n)
    left = n - 1 - i
    lo = np.maximum((i + 1) // 2, m - 1 - 2 * left)
    hi = np.minimum(2 * i, m - 1 - (left + 1) // 2)
    return (lo, hi) if bool(np.all(lo <= hi)) else None
