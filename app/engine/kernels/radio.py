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
    for s in range(nodes):
        offset[s] = 0.0
        out[s] = 0.0
    stride = max(1, (rows.shape[0] + anchors - 1) // anchors)
    for turn in range(3):
        for s in range(nodes):
            num[s] = 0.0
            den[s] = 1.0 / offset_var
        half = 0.5 / most if turn > 0 else 0.0
        for i in range(0, rows.shape[0], stride if turn < 2 else 1):
            row, r, w = rows[i], np.float32(rssi[i]), np.float32(weight[i])
            for s in range(nodes):
                deviation = np.float32(0.1) * np.float32(sd[row, s])
                e = r - np.float32(mean[row, s])
                u = (e - offset[s]) / deviation
                level = 1.0 / (1.0 + np.float32(half) * u * u)
                if turn < 2:
                    v = w * level * level / (deviation * deviation)
                    num[s] += v * e
                    den[s] += v
                else:
                    out[s] += w * (log_seen[seen[row, s]] - log_sd[sd[row, s]] - np.float32(0.5) * u * u * level)
        if turn < 2:
            for s in range(nodes):
                offset[s] = num[s] / den[s]
    for s in range(nodes):
        out[s] -= 0.5 * offset[s] * offset[s] / offset_var
