"""A track laid on a map at many places: what its readings differ by from the map's, at each.

On a *lattice* of shifts by whole cells every point keeps its bilinear weights, so the innermost loop runs along a row
of the map and vectorizes; four rows of shifts are taken at once, because each row of the map serves two of them and
because it is in the nearest cache then. *Placements* are anywhere (turned, stretched), one after the other.

Legend: ``i``, ``j`` row and column of the node below a point at the first shift, ``v``, ``u`` the fraction beyond it
towards the next row and column, ``z`` readings, ``w`` weights (1 where mapped).

The lattice kernels read nodes ``i .. i + rows`` and ``j .. j + columns``: their caller pads the map.
"""

import numpy as np
from numba import njit

BLOCK = 4
"""Rows of shifts that :func:`lattice_difference` takes at once: rows of its scratch."""


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def lattice_difference(plane, i, j, v, u, z, squared, scratch, total):
    """Add sums of ``|s - z|`` or ``(s - z)^2`` over the points, for each shift.

    Parameters
    ----------
    plane : (rows, columns) float32, one channel of the map
    i, j : (n,) int64
    v, u, z : (n,) float32
    squared : bool
    scratch : (BLOCK, shift columns) float32
    total : (shift rows, shift columns) float32, added to
    """
    rows, columns = total.shape
    n = z.shape[0]
    A0, A1, A2, A3 = scratch[0], scratch[1], scratch[2], scratch[3]
    whole = rows - rows % 4
    for y in range(0, whole, 4):
        scratch[:] = np.float32(0.0)
        for k in range(n):
            a, b, f, g, c = i[k] + y, j[k], v[k], u[k], z[k]
            R0, R1, R2 = (
                plane[a, b : b + columns + 1],
                plane[a + 1, b : b + columns + 1],
                plane[a + 2, b : b + columns + 1],
            )
            R3, R4 = plane[a + 3, b : b + columns + 1], plane[a + 4, b : b + columns + 1]
            if squared:
                for x in range(columns):
                    h0 = R0[x] + g * (R0[x + 1] - R0[x]) - c
                    h1 = R1[x] + g * (R1[x + 1] - R1[x]) - c
                    h2 = R2[x] + g * (R2[x + 1] - R2[x]) - c
                    h3 = R3[x] + g * (R3[x + 1] - R3[x]) - c
                    h4 = R4[x] + g * (R4[x + 1] - R4[x]) - c
                    d0, d1, d2, d3 = h0 + f * (h1 - h0), h1 + f * (h2 - h1), h2 + f * (h3 - h2), h3 + f * (h4 - h3)
                    A0[x] += d0 * d0
                    A1[x] += d1 * d1
                    A2[x] += d2 * d2
                    A3[x] += d3 * d3
            else:
                for x in range(columns):
                    h0 = R0[x] + g * (R0[x + 1] - R0[x]) - c
                    h1 = R1[x] + g * (R1[x + 1] - R1[x]) - c
                    h2 = R2[x] + g * (R2[x + 1] - R2[x]) - c
                    h3 = R3[x] + g * (R3[x + 1] - R3[x]) - c
                    h4 = R4[x] + g * (R4[x + 1] - R4[x]) - c
                    A0[x] += abs(h0 + f * (h1 - h0))
                    A1[x] += abs(h1 + f * (h2 - h1))
                    A2[x] += abs(h2 + f * (h3 - h2))
                    A3[x] += abs(h3 + f * (h4 - h3))
        for r in range(4):
            for x in range(columns):
                total[y + r, x] += scratch[r, x]
    for y in range(whole, rows):
        T = total[y]
        for k in range(n):
            a, b, f, g, c = i[k] + y, j[k], v[k], u[k], z[k]
            R0, R1 = plane[a, b : b + columns + 1], plane[a + 1, b : b + columns + 1]
            for x in range(columns):
                h0 = R0[x] + g * (R0[x + 1] - R0[x]) - c
                h1 = R1[x] + g * (R1[x + 1] - R1[x]) - c
                d = h0 + f * (h1 - h0)
                T[x] += d * d if squared else abs(d)


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def lattice_difference_weighted(plane, weight, i, j, v, u, z, squared, total):
    """The same with each point's difference times the weight of the node nearest to it.

    Parameters
    ----------
    plane, i, j, v, u, z, squared, total : as :func:`lattice_difference`
    weight : (rows, columns) float32
    """
    rows, columns = total.shape
    for y in range(rows):
        T = total[y]
        for k in range(z.shape[0]):
            a, b, f, g, c = i[k] + y, j[k], v[k], u[k], z[k]
            near, beside = a + int(f > 0.5), b + int(g > 0.5)
            R0, R1 = plane[a, b : b + columns + 1], plane[a + 1, b : b + columns + 1]
            W = weight[near, beside : beside + columns]
            for x in range(columns):
                h0 = R0[x] + g * (R0[x + 1] - R0[x]) - c
                h1 = R1[x] + g * (R1[x + 1] - R1[x]) - c
                d = h0 + f * (h1 - h0)
                T[x] += W[x] * (d * d if squared else abs(d))


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def lattice_weight(weight, i, j, v, u, total):
    """Add the sum of the points' weights for each shift; arguments as :func:`lattice_difference_weighted`."""
    rows, columns = total.shape
    for y in range(rows):
        T = total[y]
        for k in range(v.shape[0]):
            near, beside = i[k] + y + int(v[k] > 0.5), j[k] + int(u[k] > 0.5)
            W = weight[near, beside : beside + columns]
            for x in range(columns):
                T[x] += W[x]


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def lattice_moments(plane, weight, i, j, v, u, z, total):
    """Add sums of ``w s``, ``w s^2``, ``w s z``, ``w z`` and ``w z^2`` for each shift.

    All correlation criteria of second order follow from these. Take a common value off map and readings first: sums
    of squares of the whole field leave few digits for its differences in float32.

    Parameters
    ----------
    plane, weight, i, j, v, u, z : as :func:`lattice_difference_weighted`
    total : (5, shift rows, shift columns) float32, added to
    """
    _, rows, columns = total.shape
    for y in range(rows):
        S, SS, SZ, Z, ZZ = total[0, y], total[1, y], total[2, y], total[3, y], total[4, y]
        for k in range(z.shape[0]):
            a, b, f, g, c = i[k] + y, j[k], v[k], u[k], z[k]
            near, beside = a + int(f > 0.5), b + int(g > 0.5)
            R0, R1 = plane[a, b : b + columns + 1], plane[a + 1, b : b + columns + 1]
            W = weight[near, beside : beside + columns]
            for x in range(columns):
                h0 = R0[x] + g * (R0[x + 1] - R0[x])
                h1 = R1[x] + g * (R1[x + 1] - R1[x])
                s = h0 + f * (h1 - h0)
                ws = W[x] * s
                wz = W[x] * c
                S[x] += ws
                SS[x] += ws * s
                SZ[x] += ws * c
                Z[x] += wz
                ZZ[x] += wz * c


# not all of fast math: a placement that is not a number must fail the comparison with the map's edge
@njit(cache=True, nogil=True, fastmath={"reassoc", "contract", "nsz"}, error_model="numpy")
def placements_mad(planes, support, mapped_m, points, values, poses, squared, centred, turning, residual, cost, mapped):
    """Mean absolute (or squared) difference of a track's readings from the map, at placements anywhere.

    Points beyond the map or on unmapped ground count neither for nor against.

    Parameters
    ----------
    planes : (channels, rows, columns) float32, uT
    support : (rows, columns) float32, m; a node counts as mapped up to ``mapped_m``
    points : (n, 2) float64, cells, about the point that placements turn and stretch it about: east, north
    values : (n, channels) float64, uT
    poses : (p, 4) float64: column and row of that point (cells), rotation (rad, counter-clockwise), scale
    squared : bool, MSD instead of MAD
    centred : bool, take each channel's mean difference off first (an offset of the sensor costs nothing)
    turning : bool, channels 0 and 1 are a vector that turns with the track
    residual : (channels, n) float64 scratch
    cost : (p,) float64 output; 0 where nothing is mapped
    mapped : (p,) float64 output, share of the points on mapped ground
    """
    channels, rows, columns = planes.shape
    n = points.shape[0]
    for p in range(poses.shape[0]):
        ct, st = np.cos(poses[p, 2]), np.sin(poses[p, 2])
        cs, ss = poses[p, 3] * ct, poses[p, 3] * st
        m = 0
        for k in range(n):
            gx = poses[p, 0] + cs * points[k, 0] - ss * points[k, 1]
            gy = poses[p, 1] + ss * points[k, 0] + cs * points[k, 1]
            if not (gx >= 0.0 and gy >= 0.0 and gx <= columns - 1 and gy <= rows - 1):
                continue
            j, i = min(int(gx), max(columns - 2, 0)), min(int(gy), max(rows - 2, 0))
            j1, i1 = min(j + 1, columns - 1), min(i + 1, rows - 1)
            u, v = gx - j, gy - i
            if support[i1 if v > 0.5 else i, j1 if u > 0.5 else j] > mapped_m:
                continue
            for c in range(channels):
                h0 = planes[c, i, j] + u * (planes[c, i, j1] - planes[c, i, j])
                h1 = planes[c, i1, j] + u * (planes[c, i1, j1] - planes[c, i1, j])
                z = values[k, c]
                if turning and c < 2:
                    z = ct * values[k, 0] - st * values[k, 1] if c == 0 else st * values[k, 0] + ct * values[k, 1]
                residual[c, m] = z - h0 - v * (h1 - h0)
            m += 1
        total = 0.0
        for c in range(channels):
            mean = 0.0
            if centred:
                for k in range(m):
                    mean += residual[c, k]
                mean /= max(m, 1)
            for k in range(m):
                d = residual[c, k] - mean
                total += d * d if squared else abs(d)
        cost[p] = total / (max(m, 1) * channels)
        mapped[p] = m / n
