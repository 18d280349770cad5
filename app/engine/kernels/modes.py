"""Where particles gather: cells, and the particles about a peak."""

import numpy as np
from numba import njit


@njit(cache=True, nogil=True, fastmath=False, error_model="numpy")
def cell_of(x, y, x0, y0, cell, columns, out):
    """Number of each particle's cell, row by row.

    Parameters
    ----------
    x, y : (n,) float32, m
    x0, y0, cell : m, corner of the first cell and side of all
    columns : cells in a row
    out : (n,) int64
    """
    for i in range(x.shape[0]):
        out[i] = np.int64((np.float64(y[i]) - y0) / cell) * columns + np.int64((np.float64(x[i]) - x0) / cell)


@njit(cache=True, nogil=True, fastmath=False, error_model="numpy")
def cell_weight(cell, w, free, out):
    """Sum of the weights of the free particles in each cell.

    Parameters
    ----------
    cell : (n,) int64
    w : (n,) float32
    free : (n,) bool
    out : (cells,) float64
    """
    out[:] = 0.0
    for i in range(cell.shape[0]):
        if free[i]:
            out[cell[i]] += w[i]


@njit(cache=True, nogil=True, fastmath=False, error_model="numpy")
def gather(x, y, w, free, px, py, radius, out):
    """Moments of the free particles within a radius of a point; these are not free from then on.

    Parameters
    ----------
    x, y, w : (n,) float32, m and weight
    free : (n,) bool
    px, py, radius : m
    out : (6,) sum of weights; then weighted means of x - px and y - py, m; then covariances xx, xy, yy, m^2
    """
    out[:] = 0.0
    reach = radius * radius
    for i in range(x.shape[0]):
        if not free[i]:
            continue
        dx, dy = x[i] - px, y[i] - py
        if dx * dx + dy * dy > reach:
            continue
        free[i] = False
        v = np.float64(w[i])
        out[0] += v
        out[1] += v * dx
        out[2] += v * dy
        out[3] += v * dx * dx  # about the peak, metres away: sums of squares lose nothing there
        out[4] += v * dx * dy
        out[5] += v * dy * dy
    if out[0] > 0.0:
        for k in range(1, 6):
            out[k] /= out[0]
        out[3] -= out[1] * out[1]
        out[4] -= out[1] * out[2]
        out[5] -= out[2] * out[2]
