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
    xy : (2, n) int16 output, cm; what is farther off than ``REACH_CM`` is put there
    """
    hundred, reach = np.float32(100.0), np.float32(REACH_CM)
    rx, ry = np.float32(x0), np.float32(y0)
    for i in range(x.shape[0]):
        xy[0, i] = np.int16(np.rint(min(max((x[i] - rx) * hundred, -reach), reach)))
        xy[1, i] = np.int16(np.rint(min(max((y[i] - ry) * hundred, -reach), reach)))


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def follow(xy, ancestor, out):
    """Lines after resampling: particle ``i`` of now goes on from particle ``ancestor[i]``; all (2, n) or (n,)."""
    for i in range(ancestor.shape[0]):
        k = ancestor[i]
        out[0, i] = xy[0, k]
        out[1, i] = xy[1, k]


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def moments(xy, w, est):
    """Weighted mean and covariance of a step's lines.

    Parameters
    ----------
    xy : (2, n) int16, cm from the reference
    w : (n,) float32, weights of the particles of now, of any sum above zero
    est : (5,) output: mean x, y (m from the reference), then covariance xx, xy, yy (m^2)
    """
    total = sx = sy = sxx = sxy = syy = 0.0
    for i in range(w.shape[0]):
        x, y = 0.01 * np.float64(xy[0, i]), 0.01 * np.float64(xy[1, i])
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
