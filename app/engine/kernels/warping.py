"""The warping path of one query onto one stretch of a map; the symbols and steps are those of :mod:`.dtw`."""

from numba import njit

FAR = 1e30
"""Unreachable, and finite as fast math wants it."""
HERE, DIAGONAL, SKIP, LEFT, BEGIN = 0, 1, 2, 3, 4
"""Where a path comes from: ``(i-1, j)``, ``(i-1, j-1)``, ``(i-1, j-2)``, ``(i, j-1)``, nowhere."""


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def warping_path(q, x, lo, hi, skipping, uneven, open_ends, costs, moves, path):
    """Cheapest path of all of the query onto the stretch or, with open ends, onto a part of it.

    Parameters
    ----------
    q : (n, channels)
    x : (m, channels)
    lo, hi : (n,) first and last position that each point of the query may be matched with; neither ever falls
    skipping : True for skipping steps, False for classic ones
    uneven : added for each step that is not on the diagonal
    open_ends : (begin, end), True where the path may begin or end at any position, False where it begins with both
        first points or ends with both last ones
    costs : (2, m) scratch; row ``(n - 1) % 2`` is left with the cost by position at which the path ends
    moves : (n, m) int8 scratch
    path : (n + m, 2) output: pairs ``(i, j)`` in the *last* rows

    Returns
    -------
    cost, first : cost of the path (``FAR`` or more where there is none), and row of ``path`` in which it begins
    """
    n, m = q.shape[0], x.shape[0]
    costs[:] = FAR
    for i in range(n):
        now, before = costs[i % 2], costs[1 - i % 2]
        now[:] = FAR
        for j in range(lo[i], hi[i] + 1):
            best, move = FAR, BEGIN
            if i == 0:
                if open_ends[0] or j == 0:
                    best = 0.0
            else:
                best, move = before[j] + uneven, HERE
                # with equal costs the diagonal: a path then runs on evenly over featureless ground
                if j > 0 and before[j - 1] <= best:
                    best, move = before[j - 1], DIAGONAL
                if skipping and j > 1 and before[j - 2] + uneven < best:
                    best, move = before[j - 2] + uneven, SKIP
            if not skipping and j > 0 and now[j - 1] + uneven < best:
                best, move = now[j - 1] + uneven, LEFT
            for k in range(q.shape[1]):
                best += (q[i, k] - x[j, k]) ** 2
            now[j] = best
            moves[i, j] = move
    i, j, ends = n - 1, m - 1, costs[(n - 1) % 2]
    if open_ends[1]:
        for k in range(m):
            if ends[k] < ends[j]:
                j = k
    cost, first = ends[j], path.shape[0]
    if cost >= FAR:
        return cost, first
    while True:
        first -= 1
        path[first, 0], path[first, 1] = i, j
        move = moves[i, j]
        if move == BEGIN:
            return cost, first
        if move == LEFT:
            j -= 1
        else:
            i -= 1
            j -= move
