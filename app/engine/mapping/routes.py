"""One-dimensional maps of lanes and corridors, from repeated readings along a line.

After Bao, Shang and Shi, DTW-based declination-corrected geomagnetic matching, Chinese Journal of Sensors and Actuators
2019(10), section 1: a point every metre, from many readings of which those beyond three standard deviations are
rejected (Pauta), and generalized extension interpolation between the points. Readings here are taken in passing, not
standing on the points: each point has the readings about it brought to it along a straight line through them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from app.engine.errors import InputError
from app.engine.types import BoolArray, Float64Array, IntArray

_PAUTA = 3.0
_ROUNDS = 4
_LEAST_READINGS = 3
_EXTENSION = 2
"""Points on either side of an interval that shape the curve in it."""


@dataclass(frozen=True, slots=True, eq=False)
class RouteProfile:
    """Field along a line.

    Attributes
    ----------
    along : array, shape (m,), m
        Of the points that have readings, from the line's beginning, ascending.
    xy : array, shape (m, 2), m, level frame
    mean, sd : arrays, shape (m, channels), uT
        Field and the standard deviation of this mean.
    roughness : array, shape (channels,), uT^2/m
        Mean square by which the field changes in a metre.
    rejected : int
        Readings that were left out.
    """

    along: Float64Array
    xy: Float64Array
    mean: Float64Array
    sd: Float64Array
    roughness: Float64Array
    rejected: int

    def at(self, along: Float64Array) -> tuple[Float64Array, Float64Array]:
        """Mean and standard deviation between the points, shape (k, channels) each, uT.

        Generalized extension interpolation: in each interval a cubic that passes through both ends and fits the points
        beyond them by least squares. Its deviation is that of the ends, and what a random walk of this roughness that
        is held at both ends does between them. Outside the points the last one's value holds.
        """
        s = np.clip(along, self.along[0], self.along[-1])
        i = np.clip(np.searchsorted(self.along, s, side="right") - 1, 0, len(self.along) - 2)
        low, span = self.along[i], self.along[i + 1] - self.along[i]
        u = ((s - low) / span)[:, None]
        bend, tilt = (part[i] for part in self._cubics())
        mean = (1.0 - u) * self.mean[i] + u * self.mean[i + 1] + u * (1.0 - u) * (bend + tilt * u)
        ends = ((1.0 - u) * self.sd[i]) ** 2 + (u * self.sd[i + 1]) ** 2
        outside = np.abs(along - s)[:, None]
        between = self.roughness * (u * (1.0 - u) * span[:, None] + outside)
        return mean, np.sqrt(ends + between)

    def _cubics(self) -> tuple[Float64Array, Float64Array]:
        """For each interval, a and b of the part ``u (1 - u) (a + b u)`` of its cubic, shape (m - 1, channels)."""
        m = len(self.along)
        out = np.zeros((2, m - 1, self.mean.shape[1]))
        for i in range(m - 1):
            rows = np.r_[max(0, i - _EXTENSION) : i, i + 2 : min(m, i + 2 + _EXTENSION)]
            if not len(rows):
                continue
            u = (self.along[rows] - self.along[i]) / (self.along[i + 1] - self.along[i])
            shape = u * (1.0 - u)
            # one point alone cannot tell a tilt
            design = np.stack([shape, shape * u], axis=1)[:, : min(2, len(rows))]
            wanted = self.mean[rows] - (1.0 - u[:, None]) * self.mean[i] - u[:, None] * self.mean[i + 1]
            out[: design.shape[1], i] = np.linalg.lstsq(design, wanted, rcond=None)[0]
        return out[0], out[1]


def extend_route(
    line: Float64Array,
    xy: Float64Array,
    values: Float64Array,
    *,
    spacing_m: float = 1.0,
    width_m: float = 2.0,
) -> RouteProfile:
    """Map of a line from readings along it.

    Parameters
    ----------
    line : array, shape (k, 2), m, level frame
        Corners of the line.
    xy : array, shape (n, 2), m
        Of the readings, of all passes together.
    values : array, shape (n, channels), uT
        Offsets of devices removed.
    spacing_m : float, m
        Of the points.
    width_m : float, m
        Readings farther from the line are not of it.

    Raises
    ------
    InputError
        A line without length, or readings at fewer than two points.
    """
    legs = np.hypot(*np.diff(line, axis=0).T)
    if len(line) < 2 or not legs.sum() > 0:
        raise InputError("line", "needs two corners that lie apart")
    s, away = project(line, xy)
    near = away <= width_m
    s, values = s[near], values[near]
    point = np.round(s / spacing_m).astype(np.int64)
    keys, means, variances, counts, rejected = [], [], [], [], 0
    for key in np.unique(point):
        rows = point == key
        if rows.sum() < _LEAST_READINGS:
            continue
        mean, variance, kept = _point(s[rows] - key * spacing_m, values[rows])
        keys.append(key * spacing_m)
        means.append(mean)
        variances.append(variance)
        counts.append(int(kept.sum()))
        rejected += int((~kept).sum())
    if len(keys) < 2:
        raise InputError("xy", f"readings at {len(keys)} points of the line; at least two points need three each")
    return _profile(line, np.array(keys), np.array(means), np.array(variances), np.array(counts), rejected)


def project(line: Float64Array, xy: Float64Array) -> tuple[Float64Array, Float64Array]:
    """Way along a line to the foot of each place on it, and the distance from it, shape (n,) each, m."""
    begin, leg = line[:-1], np.diff(line, axis=0)
    length = np.hypot(*leg.T)
    u = np.einsum("nkd,kd->nk", xy[:, None] - begin, leg) / np.maximum(length**2, 1e-12)
    u = np.clip(u, 0.0, 1.0)
    away = np.linalg.norm(xy[:, None] - (begin + u[..., None] * leg), axis=-1)
    best = away.argmin(axis=1)
    rows: IntArray = np.arange(len(xy))
    before = np.concatenate([[0.0], np.cumsum(length)[:-1]])
    return before[best] + u[rows, best] * length[best], away[rows, best]


def _point(offset: Float64Array, values: Float64Array) -> tuple[Float64Array, Float64Array, BoolArray]:
    """Mean at a point, variance of a reading about the line through them, and which readings were kept."""
    kept = np.ones(len(offset), dtype=bool)
    # with all readings at one offset there is no slope to find
    sloped = bool(np.ptp(offset) > 1e-3)
    design = np.stack([np.ones(len(offset)), offset], axis=1)[:, : 1 + sloped]
    for _ in range(_ROUNDS):
        fit = np.linalg.lstsq(design[kept], values[kept], rcond=None)[0]
        residual = values - design @ fit
        freedom = max(int(kept.sum()) - design.shape[1], 1)
        variance = (residual[kept] ** 2).sum(axis=0) / freedom
        within = (residual**2 <= _PAUTA**2 * variance + 1e-12).all(axis=1)
        if (within | ~kept).all() or (kept & within).sum() < _LEAST_READINGS:
            break
        kept &= within
    return fit[0], variance, kept


def _profile(
    line: Float64Array,
    along: Float64Array,
    mean: Float64Array,
    variance: Float64Array,
    count: IntArray,
    rejected: int,
) -> RouteProfile:
    # pooled: three readings that happen to agree are no better than others
    pooled = np.average(variance, axis=0, weights=count)
    sd = np.sqrt(pooled / count[:, None])
    step = np.diff(along)
    change = np.diff(mean, axis=0) ** 2 - sd[1:] ** 2 - sd[:-1] ** 2
    roughness = np.maximum((change / step[:, None]).mean(axis=0), 0.0)
    corners = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])
    xy = np.stack([np.interp(along, corners, line[:, axis]) for axis in (0, 1)], axis=1)
    return RouteProfile(along, xy, mean, sd, roughness, rejected)
