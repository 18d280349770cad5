"""Places where particles gather."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import uniform_filter

from app.engine.filtering.particle import Cloud
from app.engine.kernels import modes as kernel

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
    x, y, w = cloud.p[0], cloud.p[1], cloud.p[14]
    x0, y0 = float(x.min()), float(y.min())
    width, height = float(x.max()) - x0, float(y.max()) - y0
    cell = max(_CELL_M, max(width, height) / _MAX_CELLS)
    shape = (int(height / cell) + 1, int(width / cell) + 1)
    at = np.empty(cloud.n, np.int64)
    kernel.cell_of(x, y, x0, y0, cell, shape[1], at)
    whole = float(w.sum(dtype=np.float64))
    modes: list[Mode] = []
    free, weight, moments = np.ones(cloud.n, np.bool_), np.empty(shape), np.empty(6)
    for _ in range(most):
        kernel.cell_weight(at, w, free, weight.reshape(-1))
        peak_r, peak_c = np.unravel_index(int(uniform_filter(weight, 3, mode="constant").argmax()), shape)
        px, py = x0 + (peak_c + 0.5) * cell, y0 + (peak_r + 0.5) * cell
        kernel.gather(x, y, w, free, px, py, max(radius_m, 3.0 * cell), moments)
        share, mx, my, xx, xy, yy = moments.tolist()
        if share <= 0.0 or (modes and share / whole < least):
            break
        modes.append(Mode(float(px) + mx, float(py) + my, max(xx, 0.0), xy, max(yy, 0.0), share / whole))
        if not free.any():
            break
    return tuple(sorted(modes, key=lambda m: -m.weight))


def whole(cloud: Cloud) -> Mode:
    """All particles as one gathering."""
    x, y, w = cloud.p[0], cloud.p[1], cloud.p[14]
    px, py, moments = float(x[0]), float(y[0]), np.empty(6)
    kernel.gather(x, y, w, np.ones(cloud.n, np.bool_), px, py, np.inf, moments)
    share, mx, my, xx, xy, yy = moments.tolist()
    return Mode(px + mx, py + my, xx, xy, yy, share)
