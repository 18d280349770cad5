"""Slow twins of the warping kernels: the recursions as they are written, over a whole matrix."""

from __future__ import annotations

import numpy as np

INF = float("inf")


def local_costs(q, x, *, squared=True):
    """Cost of every pair, shape (n, m)."""
    apart = np.abs(np.asarray(q, dtype=np.float64)[:, None, :] - np.asarray(x, dtype=np.float64)[None, :, :])
    return (apart**2 if squared else apart).sum(axis=2)


def matrix(d, *, skipping=False, uneven=0.0, open_begin=False, lo=None, hi=None):
    """Least cost of a path to every pair, infinite outside the band; shape (n, m)."""
    n, m = d.shape
    lo = np.zeros(n, dtype=int) if lo is None else lo
    hi = np.full(n, m - 1) if hi is None else hi
    cost = np.full((n, m), INF)

    def at(i, j):
        return cost[i, j] if i >= 0 and j >= 0 else INF

    for i in range(n):
        for j in range(lo[i], hi[i] + 1):
            if i == 0 and (open_begin or j == 0):
                before = 0.0
            elif skipping:
                before = min(at(i - 1, j) + uneven, at(i - 1, j - 1), at(i - 1, j - 2) + uneven)
            else:
                before = min(at(i - 1, j) + uneven, at(i, j - 1) + uneven, at(i - 1, j - 1))
            cost[i, j] = d[i, j] + before
    return cost


def window_cost(q, x, *, squared=True, skipping=False, lo=None, hi=None):
    """Cost of warping all of the query onto all of the window."""
    return matrix(local_costs(q, x, squared=squared), skipping=skipping, lo=lo, hi=hi)[-1, -1]


def subsequence_costs(q, x, *, squared=True, skipping=False, uneven=0.0):
    """Cost of the best path that ends at each position and begins anywhere, shape (m,)."""
    return matrix(local_costs(q, x, squared=squared), skipping=skipping, uneven=uneven, open_begin=True)[-1]


def path_cost(q, x, path):
    """What a path costs."""
    d = local_costs(q, x)
    return sum(d[i, j] for i, j in path)


def derivative(values):
    """Estimate of the slope from two neighbours, ends copied from theirs."""
    n = len(values)
    if n < 3:
        return np.zeros_like(values, dtype=np.float64)
    inner = [((values[i] - values[i - 1]) + (values[i + 1] - values[i - 1]) / 2.0) / 2.0 for i in range(1, n - 1)]
    return np.array([inner[0], *inner, inner[-1]])


def itakura(n, m):
    """Band of the parallelogram with slopes 1/2 and 2, from its edges pair by pair; None where there is none."""
    allowed = [
        [j for j in range(m) if i / 2 <= j <= 2 * i and (n - 1 - i) / 2 <= m - 1 - j <= 2 * (n - 1 - i)]
        for i in range(n)
    ]
    if not all(allowed):
        return None
    return np.array([row[0] for row in allowed]), np.array([row[-1] for row in allowed])
