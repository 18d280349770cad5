"""Slow twin of the comparison of passes: one pass at a time, sums by loops."""

from __future__ import annotations

import numpy as np

from app.engine.mapping.crowd.passes import Passes
from app.engine.mapping.model import Covariance
from app.engine.types import Float64Array


def naive_compare(passes: Passes, covariance: Covariance, credit: Float64Array, row: int) -> tuple[Float64Array, float]:
    """Residual (channels,) of one pass to all other witnesses, and its expected variance."""
    here = passes.cells[passes.cell[row]]
    place, value, noise = [], [], []
    for dc in (-1, 0, 1):
        for dr in (-1, 0, 1):
            node = _consensus(passes, credit, here + np.array([dc, dr]), int(passes.witness[row]))
            if node is not None:
                place.append(node[0])
                value.append(node[1])
                noise.append(node[2])
    channels = passes.value.shape[1]
    if not place:
        return passes.value[row], 1.0 + float(passes.noise[row])
    n = len(place)
    matrix = np.array([[correlation(place[i], place[j], covariance) for j in range(n)] for i in range(n)])
    matrix += np.diag(noise)
    to_node = np.array([correlation(p, passes.xy[row], covariance) for p in place])
    weight = np.linalg.solve(matrix, to_node)
    mean = sum((w * v for w, v in zip(weight, value, strict=True)), np.zeros(channels))
    return passes.value[row] - mean, float(1.0 - weight @ to_node + passes.noise[row])


def _consensus(
    passes: Passes, credit: Float64Array, cell: Float64Array, without: int
) -> tuple[Float64Array, Float64Array, float] | None:
    """Mean place, mean value and variance of a cell's passes, each witness counting once."""
    index = [i for i in range(len(passes)) if (passes.cells[passes.cell[i]] == cell).all()]
    total, place, value = 0.0, np.zeros(2), np.zeros(passes.value.shape[1])
    for i in index:
        if passes.witness[i] == without or credit[i] <= 0.0:
            continue
        own = sum(1 for j in index if passes.witness[j] == passes.witness[i] and credit[j] > 0.0)
        information = credit[i] / own / (2.0 * passes.noise[i])
        total += information
        place += information * passes.xy[i]
        value += information * passes.value[i]
    return None if total <= 1e-6 else (place / total, value / total, 1.0 / total)


def correlation(a: Float64Array, b: Float64Array, covariance: Covariance) -> float:
    """Of the field at two places: Matern 3/2, coarse and fine."""
    d = float(np.hypot(*(a - b)))
    parts = ((1.0 - covariance.fine, covariance.length_m), (covariance.fine, covariance.fine_length_m))
    return float(sum(s * (1.0 + np.sqrt(3.0) * d / le) * np.exp(-np.sqrt(3.0) * d / le) for s, le in parts))
