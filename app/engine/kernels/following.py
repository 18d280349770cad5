"""A track that follows contours: a Kalman filter and smoother of the motion's errors, fed with nearest contour points.

State (cells, steps of the normalized time; ``ORDER`` of them and one offset a channel):

= ===================================================================
0 error of the position along columns
1 along rows
2 its rate along columns
3 along rows
4 rate of that rate along columns
5 along rows
6 turn of the track about its first point, rad
7 stretch of the track about its first point, as a part of one
8 offset of the sensor's channel 0, uT; of channels 1 and 2 thereafter
= ===================================================================

A reading ``z`` says that the point lies on the contour of ``z``. Seen from the predicted point ``p``, with ``c`` the
nearest point of that contour and ``g`` the map's gradient there, it is the linear measurement ``g . (c - p)`` of
variance ``r``: with a wide prediction the gain puts the point on ``c``, with a sharp one it leaves it where it is.

Legend: ``m``, ``P`` mean and covariance, ``H`` row of the measurement matrix, ``K`` gain, ``s`` variance of an
innovation, ``e`` innovation, ``w`` value sought: reading, turned, less the offset.
"""

import numpy as np
from numba import njit

from app.engine.kernels.contours import nearest_point

ORDER = 8


@njit(cache=True, nogil=True, fastmath=False, error_model="numpy")
def predict(m, P, dt, walk, rate):
    """Let the errors grow over ``dt``; ``walk`` and ``rate`` are variances per time of position and of its rate."""
    n = m.shape[0]
    h = 0.5 * dt * dt
    for i in range(2):
        m[i] += dt * m[2 + i] + h * m[4 + i]
        m[2 + i] += dt * m[4 + i]
        for k in range(n):
            P[i, k] += dt * P[2 + i, k] + h * P[4 + i, k]
            P[2 + i, k] += dt * P[4 + i, k]
        for k in range(n):
            P[k, i] += dt * P[k, 2 + i] + h * P[k, 4 + i]
            P[k, 2 + i] += dt * P[k, 4 + i]
        P[i, i] += walk * dt + rate * dt * dt * dt / 3.0
        P[i, 2 + i] += rate * h
        P[2 + i, i] += rate * h
        P[2 + i, 2 + i] += rate * dt


@njit(cache=True, nogil=True, fastmath=False, error_model="numpy")
def back(r, dt):
    """The transpose of :func:`predict` on the smoother's vector."""
    for i in range(2):
        r[4 + i] += 0.5 * dt * dt * r[i] + dt * r[2 + i]
        r[2 + i] += dt * r[i]


@njit(cache=True, nogil=True, fastmath=False, error_model="numpy")
def place(start, state, away):
    """Where a state puts a point of the track: column, row."""
    c, s = (1.0 + state[7]) * np.cos(state[6]), (1.0 + state[7]) * np.sin(state[6])
    return (
        start[0] + state[0] + c * away[0] - s * away[1],
        start[1] + state[1] + s * away[0] + c * away[1],
    )


@njit(cache=True, nogil=True, fastmath=False, error_model="numpy")
def places(start, states, away, out):
    """Where states put the points of the track, shape (n, 2); ``states`` and ``away`` a row a point."""
    for k in range(away.shape[0]):
        out[k, 0], out[k, 1] = place(start, states[k], away[k])


@njit(cache=True, nogil=True, fastmath=False, error_model="numpy")
def sought(state, values, facing, turning, w):
    """Values whose contours a state says the point lies on: turned with the track, less the sensor's offset."""
    for c in range(values.shape[0]):
        w[c] = values[c] - state[ORDER + c]
    if turning:
        ct, st = np.cos(state[6]), np.sin(state[6])
        cf, sf = np.cos(facing + state[6]), np.sin(facing + state[6])
        w[0] = ct * values[0] - st * values[1] - cf * state[ORDER] + sf * state[ORDER + 1]
        w[1] = st * values[0] + ct * values[1] - sf * state[ORDER] - cf * state[ORDER + 1]


@njit(cache=True, nogil=True, fastmath=False, error_model="numpy")
def measurement_row(c, gx, gy, state, away, facing, turning, w, H):
    """Derivatives of map plus offset less turned reading, of channel ``c``, by the state."""
    ct, st = np.cos(state[6]), np.sin(state[6])
    ax, ay = ct * away[0] - st * away[1], st * away[0] + ct * away[1]
    H[:] = 0.0
    H[0], H[1] = gx, gy
    H[6] = (1.0 + state[7]) * (-gx * ay + gy * ax)
    H[7] = gx * ax + gy * ay
    H[ORDER + c] = 1.0
    if turning and c < 2:
        cf, sf = np.cos(facing + state[6]), np.sin(facing + state[6])
        H[ORDER], H[ORDER + 1] = (cf, -sf) if c == 0 else (sf, cf)
        H[6] += w[1] if c == 0 else -w[0]


@njit(cache=True, nogil=True, fastmath=False, error_model="numpy")
def update(m, P, K, e, s):
    """Kalman update by a scalar measurement whose gain times ``s`` is in ``K``, which becomes the gain."""
    n = m.shape[0]
    for i in range(n):
        K[i] /= s
        m[i] += K[i] * e
    for i in range(n):
        for j in range(i, n):
            P[i, j] -= K[i] * s * K[j]
            P[j, i] = P[i, j]


@njit(cache=True, nogil=True, fastmath=False, error_model="numpy")
def read_nodes(plane, x, y):
    """Bilinear value and gradient of a plane; not a number off it and where nothing is mapped."""
    rows, columns = plane.shape
    if not (x >= 0.0 and y >= 0.0 and x <= columns - 1 and y <= rows - 1) or rows < 2 or columns < 2:
        return np.nan, 0.0, 0.0
    j, i = min(int(x), columns - 2), min(int(y), rows - 2)
    u, v = x - j, y - i
    a, b = np.float64(plane[i, j]), np.float64(plane[i, j + 1]) - plane[i, j]
    c = np.float64(plane[i + 1, j]) - plane[i, j]
    d = np.float64(plane[i + 1, j + 1]) - plane[i + 1, j] - b
    return a + b * u + c * v + d * u * v, b + d * v, c + d * u


@njit(cache=True, nogil=True, fastmath=False, error_model="numpy")
def follow(planes, variances, away, dt, values, facing, turning, start, m0, P0, growth, reach, gate, about, states, P):
    """Filter forward along a track, then smooth backward.

    Readings without a contour within reach, and those that the gate refuses, leave the prediction; they are charged
    what the gate allows, so that a track is not likelier for having missed its contours.

    Parameters
    ----------
    planes : (channels, rows, columns) float32, uT; not a number where nothing is mapped
    variances : (channels, rows, columns) float32, uT^2, of a reading about the map
    away : (n, 2) cells, points less the first one
    dt : (n,) normalized time since the point before; that of the first counts not
    values : (n, channels) uT
    facing : (n,) rad, device's heading
    turning : bool, channels 0 and 1 are a vector that turns with the track
    start : (2,) cells
    m0, P0 : (ORDER + channels,), (.., ..) before the first reading
    growth : (2,) variances per time of position and of its rate
    reach : cells
    gate : standard deviations of an innovation
    about : bool, take measurements about the places that ``states`` says, rather than the predicted ones
    states : (n, ORDER + channels) input if ``about``; output, smoothed
    P : (.., ..) output, covariance of the last state

    Returns
    -------
    cost, used : minus twice the logarithm of the readings' density (without its constant), readings that counted
    """
    n, channels = values.shape
    size = m0.shape[0]
    M, PP = np.empty((n, size)), np.empty((n, size, size))
    HH, KK = np.zeros((n, channels, size)), np.zeros((n, channels, size))
    E, used = np.zeros((n, channels)), 0
    m, w, r, ref = m0.copy(), np.empty(channels), np.zeros(size), np.empty(size)
    P[:] = P0
    cost = 0.0
    for k in range(n):
        if k > 0:
            predict(m, P, dt[k], growth[0], growth[1])
        M[k], PP[k] = m, P
        ref[:] = states[k] if about else m
        x, y = place(start, ref, away[k])
        sought(ref, values[k], facing[k], turning, w)
        for c in range(channels):
            H, K = HH[k, c], KK[k, c]
            j = min(max(int(x + 0.5), 0), planes.shape[2] - 1) if abs(x) < 1e9 else 0
            i = min(max(int(y + 0.5), 0), planes.shape[1] - 1) if abs(y) < 1e9 else 0
            cx, cy, gx, gy, distance = nearest_point(planes[c], x, y, w[c], reach)
            found = np.isfinite(distance)
            if found:
                e = gx * (cx - x) + gy * (cy - y)
            else:
                mean, gx, gy = read_nodes(planes[c], x, y)
                e = w[c] - mean
                if not np.isfinite(e):
                    gx, gy, e = 0.0, 0.0, np.inf
            measurement_row(c, gx, gy, ref, away[k], facing[k], turning, w, H)
            s = np.float64(variances[c, i, j])
            for a in range(size):
                K[a] = 0.0
                for b in range(size):
                    K[a] += P[a, b] * H[b]
                s += H[a] * K[a]
                e -= H[a] * (m[a] - ref[a])
            cost += min(e * e / s, gate * gate) + np.log(s)
            if found and e * e <= gate * gate * s:
                used += 1
                E[k, c] = e / s
                update(m, P, K, e, s)
            else:
                H[:] = 0.0
                K[:] = 0.0
    for k in range(n - 1, -1, -1):  # Bryson and Frazier's form: no covariance is ever inverted
        for c in range(channels - 1, -1, -1):
            along = 0.0
            for a in range(size):
                along += KK[k, c, a] * r[a]
            for a in range(size):
                r[a] += HH[k, c, a] * (E[k, c] - along)
        for a in range(size):
            total = M[k, a]
            for b in range(size):
                total += PP[k, a, b] * r[b]
            states[k, a] = total
        if k > 0:
            back(r, dt[k])
    return cost, used
