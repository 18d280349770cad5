"""Nearest point of a contour of a bilinear map: cell after cell, in growing rings about a point.

Inside a cell the map is ``m = a + b u + c v + d u v`` and its contour a hyperbola that meets the edges where linear
interpolation says. So the ends of each piece are exact; between them the foot of the perpendicular is found by Newton
steps from that on the chord.

Legend: ``x``, ``y`` column and row (cells), ``i``, ``j`` row and column of a cell, ``u``, ``v`` fractions inside it.
Nodes that are not a number hold no contour: so callers mask what is not mapped, and fast math must stay off.
"""

import numpy as np
from numba import njit

FOUND = 5
"""Columns of what :func:`nearest_points` gives."""
_NEWTON_STEPS = 6
_ON_BEND = 8


@njit(cache=True, nogil=True, fastmath=False, error_model="numpy")
def foot_on_piece(a, b, c, d, u1, v1, u2, v2, pu, pv):
    """Point of one piece of a cell's contour nearest to ``(pu, pv)``.

    Parameters
    ----------
    a, b, c, d : coefficients of the cell less the contour's value: zero on the contour
    u1, v1, u2, v2 : ends of the piece
    pu, pv : the point, in the cell's fractions

    Returns
    -------
    u, v, squared distance
    """
    d1, d2 = (u1 - pu) ** 2 + (v1 - pv) ** 2, (u2 - pu) ** 2 + (v2 - pv) ** 2
    bu, bv, best = u1, v1, d1
    if d2 < best:
        bu, bv, best = u2, v2, d2
    lu, lv = u2 - u1, v2 - v1
    length = lu * lu + lv * lv
    if length <= 0.0:
        return bu, bv, best
    s = min(max(((pu - u1) * lu + (pv - v1) * lv) / length, 0.0), 1.0)
    u, v = u1 + s * lu, v1 + s * lv
    if abs(d) > 0.5 * max(
        abs(b), abs(c)
    ):  # a sharp bend, far from its chord: begin at the nearest of some points on it
        eu, ev = -c / d, -b / d
        first, bend = u1 - eu, (u1 - eu) * (v1 - ev)
        ratio = (u2 - eu) / first if first != 0.0 else 0.0
        near = np.inf
        if ratio > 0.0:
            for i in range(1, _ON_BEND):
                wu = first * ratio ** (i / _ON_BEND)
                squared = (eu + wu - pu) ** 2 + (ev + bend / wu - pv) ** 2
                if squared < near:
                    u, v, near = eu + wu, ev + bend / wu, squared
    low_u, high_u = min(u1, u2) - 1e-9, max(u1, u2) + 1e-9
    low_v, high_v = min(v1, v2) - 1e-9, max(v1, v2) + 1e-9
    for _ in range(_NEWTON_STEPS):  # to the contour's tangent, and along it to the foot, with its curvature
        gu, gv = b + d * v, c + d * u
        steep = gu * gu + gv * gv
        if steep <= 0.0:
            return bu, bv, best
        f = a + b * u + c * v + d * u * v
        away = gu * (pu - u) + gv * (pv - v)
        along = -gv * (pu - u) + gu * (pv - v)
        # half the squared distance's second derivative along the contour: less than one where it bends about the point
        curved = steep - 2.0 * d * gu * gv * away / steep
        t = along / max(curved, 0.3 * steep)
        u, v = u - f * gu / steep - t * gv, v - f * gv / steep + t * gu
        u, v = min(max(u, low_u), high_u), min(max(v, low_v), high_v)
    f = a + b * u + c * v + d * u * v
    gu, gv = b + d * v, c + d * u
    steep = np.sqrt(gu * gu + gv * gv)
    distance = (u - pu) ** 2 + (v - pv) ** 2
    if abs(f) <= 1e-6 * steep and distance < best:
        return u, v, distance
    return bu, bv, best


@njit(cache=True, nogil=True, fastmath=False, error_model="numpy")
def foot_in_cell(a, b, c, d, pu, pv):
    """Point of a cell's contour nearest to ``(pu, pv)``; arguments and answer as :func:`foot_on_piece`.

    The squared distance is infinite if the contour does not pass through the cell.
    """
    m00, m01, m10, m11 = a, a + b, a + c, a + b + c + d
    low, high = m00 <= 0.0, m01 <= 0.0
    top_low, top_high = m10 <= 0.0, m11 <= 0.0
    bottom, top = low != high, top_low != top_high
    left, right = low != top_low, high != top_high
    ub = m00 / (m00 - m01) if bottom else 0.0
    ut = m10 / (m10 - m11) if top else 0.0
    vl = m00 / (m00 - m10) if left else 0.0
    vr = m01 / (m01 - m11) if right else 0.0
    if bottom and top and left and right:
        # a saddle: no piece crosses the asymptote u = -c / d, so the left end goes with the end on its side of that
        if ub * d < -c if d > 0.0 else ub * d > -c:
            u1, v1, s1 = foot_on_piece(a, b, c, d, 0.0, vl, ub, 0.0, pu, pv)
            u2, v2, s2 = foot_on_piece(a, b, c, d, 1.0, vr, ut, 1.0, pu, pv)
        else:
            u1, v1, s1 = foot_on_piece(a, b, c, d, 0.0, vl, ut, 1.0, pu, pv)
            u2, v2, s2 = foot_on_piece(a, b, c, d, 1.0, vr, ub, 0.0, pu, pv)
        if s1 <= s2:
            return u1, v1, s1
        return u2, v2, s2
    if bottom and top:
        return foot_on_piece(a, b, c, d, ub, 0.0, ut, 1.0, pu, pv)
    if left and right:
        return foot_on_piece(a, b, c, d, 0.0, vl, 1.0, vr, pu, pv)
    if bottom and left:
        return foot_on_piece(a, b, c, d, ub, 0.0, 0.0, vl, pu, pv)
    if bottom and right:
        return foot_on_piece(a, b, c, d, ub, 0.0, 1.0, vr, pu, pv)
    if top and left:
        return foot_on_piece(a, b, c, d, ut, 1.0, 0.0, vl, pu, pv)
    if top and right:
        return foot_on_piece(a, b, c, d, ut, 1.0, 1.0, vr, pu, pv)
    return 0.0, 0.0, np.inf


@njit(cache=True, nogil=True, fastmath=False, error_model="numpy")
def nearest_point(plane, x, y, value, radius):
    """Point of the contour of ``value`` nearest to ``(x, y)``.

    Parameters
    ----------
    plane : (rows, columns) float32, uT; not a number where nothing is mapped
    x, y : cells
    value : uT
    radius : cells

    Returns
    -------
    column, row, gradient along columns and rows (uT/cell), distance; the last is infinite if none lies within reach
    """
    rows, columns = plane.shape
    bx, by, best = x, y, radius * radius
    gx, gy = 0.0, 0.0
    found = False
    if not (abs(x) < 1e9 and abs(y) < 1e9):
        return bx, by, gx, gy, np.inf
    j0, i0 = int(np.floor(x)), int(np.floor(y))
    fx, fy = x - j0, y - i0
    edge = min(min(fx, 1.0 - fx), min(fy, 1.0 - fy))
    for ring in range(int(np.ceil(radius)) + 1):
        if ring > 0 and (ring - 1 + edge) ** 2 > best:
            break
        for i in range(max(i0 - ring, 0), min(i0 + ring, rows - 2) + 1):
            step = 1 if i == i0 - ring or i == i0 + ring else 2 * ring
            for j in range(j0 - ring, j0 + ring + 1, max(step, 1)):
                if j < 0 or j > columns - 2:
                    continue
                m00, m01 = np.float64(plane[i, j]), np.float64(plane[i, j + 1])
                m10, m11 = np.float64(plane[i + 1, j]), np.float64(plane[i + 1, j + 1])
                if not (np.isfinite(m00) and np.isfinite(m01) and np.isfinite(m10) and np.isfinite(m11)):
                    continue
                a, b, c = m00 - value, m01 - m00, m10 - m00
                d = m11 - m10 - b
                u, v, squared = foot_in_cell(a, b, c, d, x - j, y - i)
                if squared < best:
                    best, found = squared, True
                    bx, by, gx, gy = j + u, i + v, b + d * v, c + d * u
    return bx, by, gx, gy, np.sqrt(best) if found else np.inf


@njit(cache=True, nogil=True, fastmath=False, error_model="numpy")
def nearest_points(plane, x, y, values, radius, out):
    """The same for n points, each with its own value.

    Parameters
    ----------
    plane, radius : as :func:`nearest_point`
    x, y, values : (n,) float64
    out : (n, FOUND) float64
    """
    for k in range(x.shape[0]):
        out[k, 0], out[k, 1], out[k, 2], out[k, 3], out[k, 4] = nearest_point(plane, x[k], y[k], values[k], radius)
