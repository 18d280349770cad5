"""Choice of the samples that a block of nodes is kriged from."""

import numpy as np
from numba import njit


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def spread_out(xy, walk, near, found, spacing, chosen, count):
    """Choose among the nearest samples, so that one walk's do not fill the neighbourhood.

    The first half of the places go to the nearest ones: they carry the fine part of the field. Beyond, a walk's second
    sample next to one that is taken says little more, as its errors are alike along a metre or two: those with a taken
    one of their walk within ``spacing`` are passed over. Places that are left go to the nearest of these.

    Parameters
    ----------
    xy : (n, 2) m; walk : (n,) owner
    near : (blocks, candidates) indices, nearest first; found : (blocks,) how many are valid
    spacing : m
    chosen : (blocks, k) output, indices; count : (blocks,) output, how many are valid
    """
    k = chosen.shape[1]
    taken = np.empty(near.shape[1], np.bool_)
    for p in range(near.shape[0]):
        n = 0
        for i in range(found[p]):
            a = near[p, i]
            taken[i] = n < k
            for m in range(n if n >= k // 2 else 0):
                b = chosen[p, m]
                if walk[b] == walk[a]:
                    dx, dy = xy[a, 0] - xy[b, 0], xy[a, 1] - xy[b, 1]
                    if dx * dx + dy * dy < spacing * spacing:
                        taken[i] = False
                        break
            if taken[i]:
                chosen[p, n] = a
                n += 1
        for i in range(found[p]):
            if n == k:
                break
            if not taken[i]:
                chosen[p, n] = near[p, i]
                n += 1
        count[p] = n
