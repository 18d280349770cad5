"""Block simple kriging: nodes of one block share a neighbourhood and its Cholesky factor.

Symbols: ``xy`` samples, ``z`` their centred values, ``nb`` neighbour indices of a block, ``corr`` correlation
function, ``nug`` nugget over sill. All variances are in units of the sill.
"""

import numpy as np
from numba import njit


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy", inline="always")
def matern(d, inv_length):
    """Matern 3/2 correlation at distance ``d``."""
    a = d * inv_length
    return (1.0 + a) * np.exp(-a)


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy", inline="always")
def nested(d, inv_length, fine, inv_fine):
    """Correlation of a field that is the sum of a coarse part and, with variance ``fine``, a fine one."""
    return (1.0 - fine) * matern(d, inv_length) + fine * matern(d, inv_fine)


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def krige_blocks(xy, walk, z, nb, count, nodes, first, par, mean, var):
    """Krige the nodes of each block.

    Covariance of two samples: the field's, plus, within one walk, that walk's own error, plus white noise.

    Parameters
    ----------
    xy : (n, 2) m; walk : (n,) which walk a sample belongs to
    z : (n, channels) centred values in units of each channel's sill deviation
    nb : (blocks, k) neighbour indices; count : (blocks,) how many of them are used
    nodes : (m, 2) m, nodes ordered by block; first : (blocks + 1,) start of each block's nodes
    par : (6,) inverse Matern length of the field's coarse part, variance and inverse length of the walk's error, white
        variance, variance of the field's fine part and its inverse Matern length
    mean : (m, channels), var : (m,) output, in units of sill deviation and sill
    """
    kmax = nb.shape[1]
    channels = z.shape[1]
    factor = np.empty((kmax, kmax))
    alpha = np.empty((kmax, channels))
    b = np.empty(kmax)
    inv_field, error, inv_error, white, fine, inv_fine = par[0], par[1], par[2], par[3], par[4], par[5]
    for p in range(nb.shape[0]):
        k = count[p]
        for i in range(k):
            a = nb[p, i]
            for j in range(i):
                e = nb[p, j]
                d = np.sqrt((xy[a, 0] - xy[e, 0]) ** 2 + (xy[a, 1] - xy[e, 1]) ** 2)
                c = nested(d, inv_field, fine, inv_fine)
                if walk[a] == walk[e]:
                    c += error * np.exp(-d * inv_error)
                factor[i, j] = c
            factor[i, i] = 1.0 + error + white
        for i in range(k):  # row-oriented Cholesky: inner products run along contiguous rows
            for j in range(i):
                s = factor[i, j]
                for m in range(j):
                    s -= factor[i, m] * factor[j, m]
                factor[i, j] = s * factor[j, j]
            s = factor[i, i]
            for m in range(i):
                s -= factor[i, m] * factor[i, m]
            factor[i, i] = 1.0 / np.sqrt(max(s, 1e-9))  # the diagonal holds reciprocals: no division below
        for c in range(channels):
            for i in range(k):
                s = z[nb[p, i], c]
                for m in range(i):
                    s -= factor[i, m] * alpha[m, c]
                alpha[i, c] = s * factor[i, i]
        for q in range(first[p], first[p + 1]):
            v = 1.0
            for c in range(channels):
                mean[q, c] = 0.0
            for i in range(k):
                a = nb[p, i]
                d = np.sqrt((xy[a, 0] - nodes[q, 0]) ** 2 + (xy[a, 1] - nodes[q, 1]) ** 2)
                s = nested(d, inv_field, fine, inv_fine)
                for m in range(i):
                    s -= factor[i, m] * b[m]
                s *= factor[i, i]
                b[i] = s
                v -= s * s
                for c in range(channels):
                    mean[q, c] += s * alpha[i, c]
            var[q] = max(v, 1e-6)
