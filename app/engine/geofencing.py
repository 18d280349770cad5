"""Polygons on a level, and how likely a position that is known as a normal distribution lies in one.

The probability is exact. Where the distribution is made standard (by the inverse of its covariance's Cholesky factor)
a polygon stays a polygon, and its mass is the signed sum of the triangles between the origin and its edges. In polar
coordinates the mass of a triangle whose far edge is ``h`` from the origin, seen between the angles ``a`` and ``b``
from the foot of the perpendicular, is ``(b - a)/2 pi - (T(h, tan b) - T(h, tan a))`` with Owen's T function:
D. B. Owen, "Tables for computing bivariate normal probabilities", Ann. Math. Statist. 27 (1956),
doi:10.1214/aoms/1177728074, section 3.
"""

from __future__ import annotations

import numpy as np
from scipy.special import owens_t

from app.engine.errors import InputError
from app.engine.types import BoolArray, Float64Array

MIN_VERTICES, MAX_VERTICES = 3, 200
MIN_AREA_M2 = 0.25
"""A quarter of a square metre: no position is known so well that less would ever be entered for sure."""
FAR_SD = 8.0
"""Standard deviations beyond which less than 1e-15 of a distribution lies."""
_MIN_VARIANCE = 1e-6
"""Of one millimetre squared, m^2: a distribution without width cannot be made standard."""
_COINCIDE_M = 1e-6


def simple_ring(field: str, points: Float64Array) -> Float64Array:
    """Vertices of a simple polygon, counter-clockwise and not closed.

    Parameters
    ----------
    field : str
        Name of the polygon, as the caller knows it.
    points : array, shape (n, 2), m
        Vertices in order, either way round; the first may be repeated at the end.

    Returns
    -------
    array, shape (m, 2), m

    Raises
    ------
    InputError
        If there are too few or too many vertices, an edge has no length, edges touch that are not neighbours, or the
        area is less than :data:`MIN_AREA_M2`.
    """
    if points.ndim != 2 or points.shape[1] != 2 or not np.isfinite(points).all():
        raise InputError(field, "is not a list of points [x, y] in metres")
    ring = points[:-1] if len(points) > 1 and np.array_equal(points[0], points[-1]) else points
    if not MIN_VERTICES <= len(ring) <= MAX_VERTICES:
        raise InputError(field, f"has {len(ring)} vertices; give {MIN_VERTICES} to {MAX_VERTICES}")
    lengths = np.hypot(*(np.roll(ring, -1, axis=0) - ring).T)
    short = int(np.argmin(lengths))
    if lengths[short] <= _COINCIDE_M:
        raise InputError(field, f"has the same point twice, at vertices {short} and {(short + 1) % len(ring)}")
    if (crossing := _touching_edges(ring)) is not None:
        raise InputError(field, f"crosses or touches itself: edges from vertices {crossing[0]} and {crossing[1]}")
    area = signed_area(ring)
    if abs(area) < MIN_AREA_M2:
        raise InputError(field, f"has an area of {abs(area):.3g} m^2; give at least {MIN_AREA_M2:g}")
    return np.ascontiguousarray(ring if area > 0 else ring[::-1], dtype=np.float64)


def signed_area(ring: Float64Array) -> float:
    """Area of a polygon of shape (n, 2), m^2; positive if it goes counter-clockwise."""
    x, y = (ring - ring[0]).T  # far from the origin the products would lose the area
    return float(0.5 * np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))


def inside_probability(ring: Float64Array, mean: Float64Array, covariance: Float64Array) -> Float64Array:
    """How likely positions lie in a polygon.

    Parameters
    ----------
    ring : array, shape (m, 2), m
        Vertices of a simple polygon, either way round.
    mean : array, shape (n, 2), m
    covariance : array, shape (n, 3), m^2
        ``xx``, ``xy``, ``yy`` of each.

    Returns
    -------
    array, shape (n,)
        Probabilities, 0 to 1, exact to about 1e-12.
    """
    found = np.zeros(len(mean))
    near = _near(ring, mean, covariance)
    if near.any():
        found[near] = np.clip(np.abs(_mass(_standardized(ring, mean[near], covariance[near]))), 0.0, 1.0)
    return found


def _near(ring: Float64Array, mean: Float64Array, covariance: Float64Array) -> BoolArray:
    """Which distributions reach the polygon's bounding box at all."""
    reach = FAR_SD * np.sqrt(np.maximum(covariance[:, [0, 2]], _MIN_VARIANCE))
    reaches = (mean + reach >= ring.min(axis=0)) & (mean - reach <= ring.max(axis=0))
    near: BoolArray = reaches.all(axis=1)
    return near


def _standardized(ring: Float64Array, mean: Float64Array, covariance: Float64Array) -> Float64Array:
    """The polygon as each distribution sees it once it is made standard, shape (n, m, 2)."""
    xx, xy, yy = covariance.T
    l_xx = np.sqrt(np.maximum(xx, _MIN_VARIANCE))
    l_yx = xy / l_xx
    l_yy = np.sqrt(np.maximum(yy - l_yx**2, _MIN_VARIANCE))
    away = ring[None] - mean[:, None]
    u = away[..., 0] / l_xx[:, None]
    v = (away[..., 1] - l_yx[:, None] * u) / l_yy[:, None]
    return np.stack([u, v], axis=-1)


def _mass(rings: Float64Array) -> Float64Array:
    """Signed mass of the standard normal distribution in polygons of shape (n, m, 2)."""
    a, b = rings, np.roll(rings, -1, axis=1)
    edge = b - a
    length = np.hypot(edge[..., 0], edge[..., 1])
    along = edge / np.where(length > 0.0, length, 1.0)[..., None]
    # h: signed distance of the edge's line from the origin; s, e: where on it the edge starts and ends
    h = a[..., 0] * along[..., 1] - a[..., 1] * along[..., 0]
    s, e = ((p * along).sum(axis=-1) for p in (a, b))
    distance = np.abs(h)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        wedge = (np.arctan2(e, distance) - np.arctan2(s, distance)) / (2.0 * np.pi)
        beyond = owens_t(distance, e / distance) - owens_t(distance, s / distance)
    # seen from a point of its own line an edge spans no triangle
    mass = np.where(distance > 0.0, np.sign(h) * (wedge - beyond), 0.0)
    total: Float64Array = mass.sum(axis=1)
    return total


def _touching_edges(ring: Float64Array) -> tuple[int, int] | None:
    """First two edges (by their first vertex) that have a point in common and ought not to; None if the ring is simple.

    Neighbours share a vertex; they ought not to fold back onto one another.
    """
    n = len(ring)
    a, b = ring, np.roll(ring, -1, axis=0)
    first, second = np.triu_indices(n, 1)
    folded = _fold_back(a, b)
    if folded is not None:
        return folded, (folded + 1) % n
    apart = (second - first > 1) & ~((first == 0) & (second == n - 1))
    i, j = first[apart], second[apart]
    touching = np.flatnonzero(_segments_touch(a[i], b[i], a[j], b[j]))
    return (int(i[touching[0]]), int(j[touching[0]])) if touching.size else None


def _fold_back(a: Float64Array, b: Float64Array) -> int | None:
    """First edge whose successor runs back along it."""
    edge = b - a
    following = np.roll(edge, -1, axis=0)
    scale = np.hypot(*edge.T) * np.hypot(*following.T)
    back = (np.abs(_cross(edge, following)) <= 1e-12 * scale) & ((edge * following).sum(axis=1) < 0.0)
    found = np.flatnonzero(back)
    return int(found[0]) if found.size else None


def _segments_touch(a: Float64Array, b: Float64Array, c: Float64Array, d: Float64Array) -> BoolArray:
    """Whether the segments a-b and c-d, each of shape (n, 2), have a point in common."""
    ends = [_cross(b - a, c - a), _cross(b - a, d - a), _cross(d - c, a - c), _cross(d - c, b - c)]
    proper = (np.sign(ends[0]) * np.sign(ends[1]) < 0) & (np.sign(ends[2]) * np.sign(ends[3]) < 0)
    touch: BoolArray = proper
    for side, p, q, r in ((ends[0], a, b, c), (ends[1], a, b, d), (ends[2], c, d, a), (ends[3], c, d, b)):
        in_box = ((r >= np.minimum(p, q)) & (r <= np.maximum(p, q))).all(axis=1)
        touch = touch | ((side == 0.0) & in_box)
    return touch


def _cross(u: Float64Array, v: Float64Array) -> Float64Array:
    crossed: Float64Array = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    return crossed
