"""First particles of a session, from what is known before it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from app.engine.filtering import Cloud, FilterGrid
from app.engine.inertial.stride import SPREAD
from app.engine.types import FeatureSet, Float64Array, Prior


@dataclass(frozen=True, slots=True)
class InitialSpread:
    """Spread of what is unknown at the start.

    Attributes
    ----------
    carry : float, rad
    offset_horizontal, offset_vertical : float, uT
        Hard iron left by the platform's calibration.
    compass : float, rad
        Error of the heading read off the horizontal field.
    compass_failure : float
        Share of particles that ignore the compass.
    unmapped : float
        Share of particles of an unknown start that stand where people can walk but nobody surveyed.
    """

    carry: float = 0.11
    offset_horizontal: float = 5.5
    offset_vertical: float = 5.5
    compass: float = 0.38
    compass_failure: float = 0.1
    unmapped: float = 0.25


def initial_cloud(
    prior: Prior, grid: FilterGrid, field: Float64Array, n: int, spread: InitialSpread, rng: np.random.Generator
) -> Cloud:
    """Particles before the first step.

    Parameters
    ----------
    prior : Prior
    field : array, shape (3,), uT
        First field reading (forward, left, up); its horizontal part is a compass against the map's.
    n : int
        Number of particles.
    """
    cloud = Cloud.empty(n)
    x, y = _positions(prior, grid, n, spread.unmapped, rng)
    heading = _headings(prior, grid, field, x, y, spread, rng)
    p = cloud.p
    p[0], p[1] = x, y
    p[2], p[3] = np.cos(heading), np.sin(heading)
    known = prior.calibration
    scale, scale_sd = (1.0, SPREAD) if known is None else (known.stride_scale, min(known.stride_scale_sd, SPREAD))
    p[4] = scale + scale_sd * rng.standard_normal(n).clip(-2.5, 2.5)
    p[5] = spread.carry * rng.standard_normal(n)
    p[12] = spread.offset_horizontal**2
    p[13] = spread.offset_vertical**2
    if known is not None:
        p[6:9] = np.array(known.offset)[:, None]
        p[12] = min(max(known.offset_sd[:2]), spread.offset_horizontal) ** 2
        p[13] = min(known.offset_sd[2], spread.offset_vertical) ** 2
    return cloud


WALKING_M_S = 1.4
FORGET_S = 60.0
"""After this long unwatched a walker may be anywhere: the session starts anew, with an unknown start."""


def cloud_after_gap(
    cloud: Cloud,
    gap_s: float,
    grid: FilterGrid,
    field: Float64Array,
    n: int,
    spread: InitialSpread,
    rng: np.random.Generator,
) -> Cloud:
    """Particles after a time nobody watched.

    Each may have walked any way for the whole gap, or stood; the heading is read anew off the field. What was learned
    of stride, carrying and hard iron stays.

    Parameters
    ----------
    gap_s : float, s
    field : array, shape (3,), uT
        First field reading after the gap (forward, left, up).
    n : int
        Number of particles to go on with.
    """
    wide = cloud.thin(n, float(rng.random()))
    reach = WALKING_M_S * gap_s * np.sqrt(rng.random(n))
    angle = rng.uniform(-np.pi, np.pi, n)
    x = wide.p[0] + reach * np.cos(angle)
    y = wide.p[1] + reach * np.sin(angle)
    heading = _headings(Prior(None), grid, field, x, y, spread, rng)
    wide.p[0], wide.p[1] = x, y
    wide.p[2], wide.p[3] = np.cos(heading), np.sin(heading)
    return Cloud(wide.p, moved=False)


def _positions(
    prior: Prior, grid: FilterGrid, n: int, unmapped: float, rng: np.random.Generator
) -> tuple[Float64Array, Float64Array]:
    if prior.x is not None and prior.y is not None:
        r = prior.radius_m * np.sqrt(rng.random(n))
        angle = 2.0 * np.pi * rng.random(n)
        return prior.x + r * np.cos(angle), prior.y + r * np.sin(angle)
    mapped, walkable = grid.nodes[..., 5] > 0.5, grid.nodes[..., 6] > 0.5
    inside, outside = np.flatnonzero(mapped), np.flatnonzero(walkable & ~mapped)
    n_outside = n if inside.shape[0] == 0 else int(unmapped * n) if outside.shape[0] else 0
    if outside.shape[0] == 0:
        outside = np.arange(mapped.size)
    pick = np.concatenate([rng.choice(inside, n - n_outside), rng.choice(outside, n_outside)])
    rows, columns = np.divmod(pick, mapped.shape[1])
    jitter = rng.uniform(-0.5, 0.5, size=(2, n))
    return grid.x0 + (columns + jitter[0]) * grid.cell_m, grid.y0 + (rows + jitter[1]) * grid.cell_m


def _headings(
    prior: Prior,
    grid: FilterGrid,
    field: Float64Array,
    x: Float64Array,
    y: Float64Array,
    spread: InitialSpread,
    rng: np.random.Generator,
) -> Float64Array:
    n = x.shape[0]
    if prior.heading is not None:
        return np.asarray(prior.heading + prior.heading_sd * rng.standard_normal(size=n))
    anywhere = np.asarray(rng.uniform(-np.pi, np.pi, size=n))
    if grid.features is not FeatureSet.VECTOR:
        return anywhere
    nodes = grid.lookup(x, y)
    compass = np.arctan2(nodes[:, 1], nodes[:, 0]) - np.arctan2(field[1], field[0])
    compass = compass + spread.compass * rng.standard_normal(n)
    return np.where(rng.random(n) < spread.compass_failure, anywhere, compass)
