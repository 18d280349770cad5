"""What a walker can know of the place: covariance recursions along lines of a map, and other places that look alike.

State: x, y, heading error, then per channel the sensor's offset, then per channel the error that readings share with
their neighbours (of unit variance). ``P`` is its covariance, (d, d) with d = 3 + 2 channels.

Parameters ``q``: variance per metre 0 along, 1 across, 2 of the heading, 3 of the offsets; 4 inverse correlation length
of the shared error, 5 metres a reading stands for; at the start 6 variance of the position per axis, 7 of the heading,
8 of the offsets.
"""

import numpy as np
from numba import njit


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def start(P, q):
    """Set ``P`` to what is known before the first reading."""
    d = P.shape[0]
    channels = (d - 3) // 2
    P[:, :] = 0.0
    P[0, 0] = P[1, 1] = q[6]
    P[2, 2] = q[7]
    for k in range(channels):
        P[3 + k, 3 + k] = q[8]
        P[3 + channels + k, 3 + channels + k] = 1.0


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def predict(P, ds, c, s, q):
    """Walk ``ds`` metres along the direction (c, s): dead reckoning adds its errors, shared errors are renewed."""
    d = P.shape[0]
    channels = (d - 3) // 2
    # x and y take on the heading error, times the way: P <- F P F'
    for j in range(d):
        P[0, j] -= ds * s * P[2, j]
        P[1, j] += ds * c * P[2, j]
    for i in range(d):
        P[i, 0] -= ds * s * P[i, 2]
        P[i, 1] += ds * c * P[i, 2]
    rho = np.exp(-ds * q[4])
    for k in range(3 + channels, d):
        for j in range(d):
            P[k, j] *= rho
            P[j, k] *= rho
        P[k, k] += 1.0 - rho * rho
    P[0, 0] += ds * (c * c * q[0] + s * s * q[1])
    P[1, 1] += ds * (s * s * q[0] + c * c * q[1])
    cross = ds * c * s * (q[0] - q[1])
    P[0, 1] += cross
    P[1, 0] += cross
    P[2, 2] += ds * q[2]
    for k in range(3, 3 + channels):
        P[k, k] += ds * q[3]


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def update(P, node, share, white, vector, c, s, g):
    """Take in a reading of all channels.

    Parameters
    ----------
    node : (channels, 4) mean, its slopes along x and y, variance of the map
    share, white : (channels,) variance of the readings' shared error and of their own
    vector : whether channels 0 and 1 turn with the walker
    g : (d,) scratch
    """
    d = P.shape[0]
    channels = node.shape[0]
    for k in range(channels):
        gx, gy = np.float64(node[k, 1]), np.float64(node[k, 2])
        a = np.sqrt(share[k] + np.float64(node[k, 3]))
        turn = 0.0
        b0, b1, w0, w1 = 3 + k, 3 + k, 1.0, 0.0
        if vector and k < 2:
            # level-frame readings are turned by the heading that is believed, the device's offset with them
            turn = np.float64(node[1, 0]) if k == 0 else -np.float64(node[0, 0])
            b0, b1 = 3, 4
            w0, w1 = (c, -s) if k == 0 else (s, c)
        e = 3 + channels + k
        for i in range(d):
            g[i] = gx * P[i, 0] + gy * P[i, 1] + turn * P[i, 2] + w0 * P[i, b0] + w1 * P[i, b1] + a * P[i, e]
        v = gx * g[0] + gy * g[1] + turn * g[2] + w0 * g[b0] + w1 * g[b1] + a * g[e] + white[k]
        gain = 1.0 / v
        for i in range(d):
            gi = g[i] * gain
            for j in range(d):
                P[i, j] -= gi * g[j]


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def _read(P, node, share, white, ds, vector, c, s, q, scaled, g):
    # white errors average over the readings that fall on the stretch
    for k in range(white.shape[0]):
        scaled[k] = white[k] * q[5] / ds
    update(P, node, share, scaled, vector, c, s, g)


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def scan(nodes, walkable, mapped, cell, move, share, white, vector, q, cov, run):
    """Walk all lines of nodes of one direction; one reading a node.

    Parameters
    ----------
    nodes : (rows, columns, channels, 4) float32, see :func:`update`
    walkable, mapped : (rows, columns) bool
    cell : m
    move : (2,) rows and columns to the next node, each -1, 0 or 1
    cov : (rows, columns, 3) float32 output: xx, xy, yy, m^2; written where mapped and walkable
    run : (rows, columns) float32 output, likewise: how far the walker has come along the line, m
    """
    rows, columns, channels, _ = nodes.shape
    d = 3 + 2 * channels
    P, g, scaled = np.empty((d, d)), np.empty(d), np.empty(channels)
    dr, dc = move[0], move[1]
    ds = cell * np.sqrt(np.float64(dr * dr + dc * dc))
    c, s = dc * cell / ds, dr * cell / ds
    for r0 in range(rows):
        for c0 in range(columns):
            if 0 <= r0 - dr < rows and 0 <= c0 - dc < columns:
                continue  # not the first node of a line
            r, k = r0, c0
            fresh, walked = True, 0.0
            while 0 <= r < rows and 0 <= k < columns:
                if not walkable[r, k]:
                    fresh = True
                else:
                    if fresh:
                        start(P, q)
                        fresh, walked = False, 0.0
                    else:
                        predict(P, ds, c, s, q)
                        walked += ds
                    if mapped[r, k]:
                        _read(P, nodes[r, k], share, white, ds, vector, c, s, q, scaled, g)
                        cov[r, k, 0], cov[r, k, 1], cov[r, k, 2] = P[0, 0], P[0, 1], P[1, 1]
                        run[r, k] = walked
                    elif P[0, 0] + P[1, 1] > 2.0 * q[6]:
                        fresh = True  # after a long gap nothing is left of what was known
                r += dr
                k += dc


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def along(nodes, mapped, ds, c, s, share, white, vector, q, cov):
    """Walk one route; one reading a point that is mapped.

    Parameters
    ----------
    nodes : (n, channels, 4) float32, see :func:`update`
    mapped : (n,) bool
    ds, c, s : (n,) way from the point before, m, and its direction; ``ds[0]`` is the way a first reading stands for
    cov : (n, 3) output: xx, xy, yy, m^2
    """
    n, channels, _ = nodes.shape
    d = 3 + 2 * channels
    P, g, scaled = np.empty((d, d)), np.empty(d), np.empty(channels)
    start(P, q)
    for i in range(n):
        if i > 0:
            predict(P, ds[i], c[i], s[i], q)
        if mapped[i]:
            _read(P, nodes[i], share, white, ds[i], vector, c[i], s[i], q, scaled, g)
        cov[i, 0], cov[i, 1], cov[i, 2] = P[0, 0], P[0, 1], P[1, 1]


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def rivals(mean, mapped, rows, columns, weight, least, near, worst, best):
    """Find for a stretch the other place of the level that looks most like it, the same way round.

    All points of the stretch are moved by the same whole nodes. What is compared are shapes: each channel's mean
    difference is taken out, as an unknown offset of the sensor would be.

    Parameters
    ----------
    mean : (rows, columns, channels) float32, uT
    mapped : (rows, columns) bool
    rows, columns : (n,) int64, nodes of the stretch
    weight : (channels,) 1 / uT^2 of each squared difference
    least : points that must be mapped at the other place
    near : moves of fewer nodes than this are the same place
    worst : sums above this are not told apart from it
    best : (3,) output: smallest weighted sum of squares (scaled to all n points), its move in rows and columns
    """
    height, width, channels = mean.shape
    n = rows.shape[0]
    sums, squares = np.empty(channels), np.empty(channels)
    best[0], best[1], best[2] = worst, 0.0, 0.0
    r_lo, r_hi, c_lo, c_hi = rows.min(), rows.max(), columns.min(), columns.max()
    for dr in range(-r_lo, height - r_hi):
        for dc in range(-c_lo, width - c_hi):
            if dr * dr + dc * dc < near * near:
                continue
            sums[:] = 0.0
            squares[:] = 0.0
            count, cost = 0, 0.0
            for i in range(n):
                a, b = rows[i], columns[i]
                if not mapped[a + dr, b + dc]:
                    if i + 1 - count > n - least:
                        break
                    continue
                count += 1
                cost = 0.0
                for k in range(channels):
                    v = np.float64(mean[a + dr, b + dc, k]) - np.float64(mean[a, b, k])
                    sums[k] += v
                    squares[k] += v * v
                    cost += weight[k] * (squares[k] - sums[k] * sums[k] / count)
                # the sum about the mean only grows with more points
                if cost >= best[0]:
                    break
            if count >= least:
                cost *= n / count
                if cost < best[0]:
                    best[0], best[1], best[2] = cost, dr, dc
