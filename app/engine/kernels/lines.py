"""Lines of particles: where the particles of now, or those they descend from, were at an earlier step.

A line's place at a step is an int16 pair, centimetres from a reference that all of the step's lines share.
"""

import numpy as np
from numba import njit

REACH_CM = 32767


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def record(x, y, x0, y0, xy):
    """Places of all particles as they are now.

    Parameters
    ----------
    x, y : (n,) float32, m
    x0, y0 : reference, m
    xy : (n, 2) int16 output, cm; what is farther off than ``REACH_CM`` is put there
    """
    hundred, reach = np.float32(100.0), np.float32(REACH_CM)
    rx, ry = np.float32(x0), np.float32(y0)
    for i in range(x.shape[0]):
        xy[i, 0] = np.int16(np.rint(min(max((x[i] - rx) * hundred, -reach), reach)))
        xy[i, 1] = np.int16(np.rint(min(max((y[i] - ry) * hundred, -reach), reach)))


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def moments(xy, w, est):
    """Weighted mean and covariance of a step's lines.

    Parameters
    ----------
    xy : (n, 2) int16, cm from the reference
    w : (n,) float32, weights of the particles of now, of any sum above zero
    est : (5,) output: mean x, y (m from the reference), then covariance xx, xy, yy (m^2)
    """
    total = sx = sy = sxx = sxy = syy = 0.0
    for i in range(w.shape[0]):
        x, y = 0.01 * np.float64(xy[i, 0]), 0.01 * np.float64(xy[i, 1])
        v = np.float64(w[i])
        total += v
        sx += v * x
        sy += v * y
        sxx += v * x * x
        sxy += v * x * y
        syy += v * y * y
    # the reference lies among the lines, so that little cancels here
    mx, my = sx / total, sy / total
    est[0], est[1] = mx, my
    est[2], est[3], est[4] = sxx / total - mx * mx, sxy / total - mx * my, syy / total - my * my
