"""Places where particles gather."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import uniform_filter

from app.engine.filtering.particle import Cloud
from app.engine.types import BoolArray, Float64Array

_CELL_M = 2.0
_MAX_CELLS = 500
"""Per side: a cloud spread over kilometres is looked at with coarser cells."""


@dataclass(frozen=True, slots=True)
class Mode:
    """One gathering: weighted mean (m) and covariance (m^2) of the particles near its peak, and their share."""

    x: float
    y: float
    cov_xx: float
    cov_xy: float
    cov_yy: float
    weight: float

    def weighted(self, share: float) -> Mode:
        """The same gathering where these particles have only a share of the belief."""
        return replace(self, weight=self.weight * share)


def find_modes(cloud: Cloud, *, radius_m: float = 6.0, most: int = 5, least: float = 0.02) -> tuple[Mode, ...]:
    """Modes of the particles' positions, heaviest first.

    Peaks of the weight in 2 m cells, smoothed over their neighbours; a mode takes the particles within ``radius_m``
    of its peak, and what one mode took is not the next one's.

    Parameters
    ----------
    radius_m : float
        At least three cells: the smoothed peak may be a neighbour of the fullest one.
    most : int
        At most so many modes.
    least : float
        Weight below which a gathering is none (the heaviest always counts).
    """
    x, y = cloud.p[0].astype(np.float64), cloud.p[1].astype(np.float64)
    w = cloud.p[14].astype(np.float64)
    w /= w.sum()
    cell = max(_CELL_M, float(max(np.ptp(x), np.ptp(y))) / _MAX_CELLS)
    columns, rows = ((v - v.min()) // cell for v in (x, y))
    c, r = columns.astype(np.int64), rows.astype(np.int64)
    shape = (int(r.max()) + 1, int(c.max()) + 1)
    modes: list[Mode] = []
    free = np.ones(x.shape[0], dtype=bool)
    for _ in range(most):
        weight = np.bincount(r[free] * shape[1] + c[free], weights=w[free], minlength=shape[0] * shape[1])
        smooth = uniform_filter(weight.reshape(shape), 3, mode="constant")
        peak_r, peak_c = np.unravel_index(int(smooth.argmax()), shape)
        px, py = x.min() + (peak_c + 0.5) * cell, y.min() + (peak_r + 0.5) * cell
        mode = _mode(x, y, w, free, px, py, max(radius_m, 3.0 * cell))
        if mode is None or (modes and mode.weight < least):
            break
        modes.append(mode)
        if not free.any():
            break
    return tuple(sorted(modes, key=lambda m: -m.weight))


def _mode(
    x: Float64Array, y: Float64Array, w: Float64Array, free: BoolArray, px: float, py: float, radius_m: float
) -> Mode | None:
    """Mode at a peak; takes its particles out of ``free``."""
    near = free & (np.hypot(x - px, y - py) <= radius_m)
    weight = float(w[near].sum())
    if weight <= 0.0:
        return None
    v = w[near] / weight
    mx, my = float(v @ x[near]), float(v @ y[near])
    dx, dy = x[near] - mx, y[near] - my
    free &= ~near
    return Mode(mx, my, float(v @ dx**2), float(v @ (dx * dy)), float(v @ dy**2), weight)
