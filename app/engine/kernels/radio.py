"""Log-likelihood of a radio scan at every node of a radio map."""

import numpy as np
from numba import njit


@njit(cache=True, nogil=True, error_model="numpy", fastmath=True)
def scan_log_likelihood(rows, rssi, weight, mean, sd, seen, log_seen, log_sd, offset_var, most, anchors, work, out):
    """Weighted sum of each reading's log-likelihood, with a common offset of the device marginalized per node.

    A reading's residual ``u`` (in standard deviations) costs ``u^2 / 2 / (1 + u^2 / (2 most))``: a parabola that levels
    off at ``most``. The offset is the weighted mean of the residuals, found twice, the second time with the weights of
    that loss; of many readings about ``anchors``, evenly picked, are enough for it.

    Parameters
    ----------
    rows : (k,) rows of the transmitters heard
    rssi : (k,) dBm
    weight : (k,)
    mean, sd, seen : (transmitters, nodes) int8 dBm, uint8 0.1 dB, uint8 1/255
    log_seen, log_sd : (256,) logarithms of the probability and of the deviation that a byte stands for
    offset_var : dB^2, prior variance of the device's offset
    most : the largest cost
    anchors : at least half as many, and at most so many readings make the offset
    work : (3, nodes) scratch
    out : (nodes,)
    """
    offset, num, den = work[0], work[1], work[2]
    nodes = out.shape[0]
    # all in single precision: one constant in double halves how many nodes are taken at a time
    zero, one, half, tenth = np.float32(0.0), np.float32(1.0), np.float32(0.5), np.float32(0.1)
    inv_var = np.float32(1.0 / offset_var)
    for s in range(nodes):
        offset[s] = zero
        out[s] = zero
    stride = max(1, (rows.shape[0] + anchors - 1) // anchors)
    for turn in range(2):
        for s in range(nodes):
            num[s] = zero
            den[s] = inv_var
        bend = np.float32(0.5 / most) if turn > 0 else zero
        for i in range(0, rows.shape[0], stride):
            r, w = np.float32(rssi[i]), np.float32(weight[i])
            m, d = mean[rows[i]], sd[rows[i]]
            for s in range(nodes):
                inv = one / (tenth * np.float32(d[s]))
                e = r - np.float32(m[s])
                u = (e - offset[s]) * inv
                level = inv / (one + bend * u * u)
                v = w * level * level
                num[s] += v * e
                den[s] += v
        for s in range(nodes):
            offset[s] = num[s] / den[s]
    bend = np.float32(0.5 / most)
    for i in range(rows.shape[0]):
        r, w = np.float32(rssi[i]), np.float32(weight[i])
        m, d, p = mean[rows[i]], sd[rows[i]], seen[rows[i]]
        for s in range(nodes):
            deviation = tenth * np.float32(d[s])
            e = r - np.float32(m[s]) - offset[s]
            cost = half * e * e / (deviation * deviation + bend * e * e)
            out[s] += w * (log_seen[p[s]] - log_sd[d[s]] - cost)
    for s in range(nodes):
        out[s] -= half * offset[s] * offset[s] * inv_var


@njit(cache=True, nogil=True, error_model="numpy", fastmath=False)
def interpolate(grid, x0, y0, cell, x, y, out):
    """Bilinear look-up; beyond the grid its edge holds.

    Parameters
    ----------
    grid : (rows, columns)
    x0, y0, cell : m, position of node (0, 0) and distance of the nodes
    x, y : (n,) m
    out : (n,)
    """
    rows, columns = grid.shape
    for i in range(x.shape[0]):
        c = min(max((x[i] - x0) / cell, 0.0), columns - 1.0)
        r = min(max((y[i] - y0) / cell, 0.0), rows - 1.0)
        c0, r0 = min(int(c), max(columns - 2, 0)), min(int(r), max(rows - 2, 0))
        c1, r1 = min(c0 + 1, columns - 1), min(r0 + 1, rows - 1)
        fc, fr = c - c0, r - r0
        low = (1.0 - fc) * grid[r0, c0] + fc * grid[r0, c1]
        high = (1.0 - fc) * grid[r1, c0] + fc * grid[r1, c1]
        out[i] = (1.0 - fr) * low + fr * high
