"""A track laid on a map at many places: what its readings differ by from the map's, at each.

On a *lattice* of shifts by whole cells every point keeps its bilinear weights, so the innermost loop runs along a row
of the map and vectorizes. *Placements* are anywhere (turned, stretched), one after the other.

Legend: ``i``, ``j`` row and column of the node below a point at the first shift, ``v``, ``u`` the fraction beyond it
towards the next row and column, ``z`` readings, ``w`` weights (1 where mapped).

The lattice kernels read nodes ``i .. i + shift rows`` and ``j .. j + shift columns``: their caller pads the map.
"""

import numpy as np
from numba import njit


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def lattice_difference(plane, weight, offset, i, j, v, u, z, squared, total):
    """Add sums of ``w |s - z|`` or ``w (s - z)^2`` over the points, for each shift; in lanes: ``lanes_contour``.

    Parameters
    ----------
    plane : (rows, columns) float32, one channel of the map
    weight : (rows, columns) float32, of the node nearest to a point
    offset : (shift rows, shift columns) float32, added to the map at each shift
    i, j : (n,) int64
    v, u, z : (n,) float32
    squared : bool
    total : (shift rows, shift columns) float32, added to
    """
    rows, columns = total.shape
    for y in range(rows):
        T, B = total[y], offset[y]
        for k in range(z.shape[0]):
            a, b, f, g, c = i[k] + y, j[k], v[k], u[k], z[k]
            near, beside = a + int(f > 0.5), b + int(g > 0.5)
            R0, R1 = plane[a, b : b + columns + 1], plane[a + 1, b : b + columns + 1]
            W = weight[near, beside : beside + columns]
            for x in range(columns):
                h0 = R0[x] + g * (R0[x + 1] - R0[x]) - c
                h1 = R1[x] + g * (R1[x + 1] - R1[x]) - c
                d = h0 + f * (h1 - h0) + B[x]
                T[x] += W[x] * (d * d if squared else abs(d))


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def lattice_weight(weight, i, j, v, u, total):
    """Add the sum of the points' weights for each shift; arguments as :func:`lattice_difference`."""
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
    plane, weight, i, j, v, u, z : as :func:`lattice_difference`
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
    last_column, last_row = float(columns - 1), float(rows - 1)
    jm, im = max(columns - 2, 0), max(rows - 2, 0)
    right, below = min(1, columns - 1), min(1, rows - 1) * columns
    flat, distance = planes.reshape(channels, rows * columns), support.reshape(rows * columns)
    X, Y = points[:, 0].copy(), points[:, 1].copy()
    U, V, W, A = np.empty(n), np.empty(n), np.empty(n), np.empty(n, np.int64)
    for p in range(poses.shape[0]):
        ct, st = np.cos(poses[p, 2]), np.sin(poses[p, 2])
        cs, ss = poses[p, 3] * ct, poses[p, 3] * st
        for k in range(n):  # no branches: all that can be done for several points at once is done here
            gx = poses[p, 0] + cs * X[k] - ss * Y[k]
            gy = poses[p, 1] + ss * X[k] + cs * Y[k]
            on = (gx >= 0.0) & (gy >= 0.0) & (gx <= last_column) & (gy <= last_row)
            gx, gy = gx if on else 0.0, gy if on else 0.0
            j, i = min(np.int32(gx), jm), min(np.int32(gy), im)
            U[k], V[k], W[k], A[k] = gx - j, gy - i, 1.0 if on else 0.0, i * columns + j
        count = 0.0
        for k in range(n):
            near = A[k] + (below if V[k] > 0.5 else 0) + (right if U[k] > 0.5 else 0)
            if not distance[near] <= mapped_m:
                W[k] = 0.0
            count += W[k]
        total = 0.0
        for c in range(channels):
            M, R = flat[c], residual[c]
            mean = 0.0
            for k in range(n):
                a, b = A[k], A[k] + below
                h0, h1 = M[a] + U[k] * (M[a + right] - M[a]), M[b] + U[k] * (M[b + right] - M[b])
                z = values[k, c]
                if turning and c < 2:
                    z = ct * values[k, 0] - st * values[k, 1] if c == 0 else st * values[k, 0] + ct * values[k, 1]
                R[k] = z - h0 - V[k] * (h1 - h0)
                mean += W[k] * R[k]
            mean = mean / max(count, 1.0) if centred else 0.0
            for k in range(n):
                d = R[k] - mean
                total += W[k] * (d * d if squared else abs(d))
        cost[p] = total / (max(count, 1.0) * channels)
        mapped[p] = count / n


@njit(cache=True, nogil=True, fastmath=False, error_model="numpy")
def keep_lowest(cost, k, lowest, which):
    """Where ``cost`` is below ``lowest`` (both (rows, columns) float32), put it there and ``k`` into ``which``."""
    for y in range(lowest.shape[0]):
        for x in range(lowest.shape[1]):
            if cost[y, x] < lowest[y, x]:
                lowest[y, x] = cost[y, x]
                which[y, x] = k
