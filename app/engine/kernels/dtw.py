"""Dynamic time warping of one query against many places of a map, 32 of them at a time.

Symbols: ``q`` query, ``x`` map, ``i`` the query's points ``0..n-1``, ``j`` positions of the map, ``d`` local cost,
``D`` least cost of a path that ends in a pair. Local costs are squared differences in float32 and absolute ones in
uint16 (:func:`lanes.add_cost`), summed over one to three channels. Two step patterns:

* classic: ``D(i, j) = d(i, j) + min(D(i-1, j), D(i, j-1), D(i-1, j-1))``;
* skipping: ``D(i, j) = d(i, j) + min(D(i-1, j), D(i-1, j-1), D(i-1, j-2))``, in which every point of the query counts
  once and the map goes on by two points at most.

The map is stored ``(position, channel, lane)``: what a cell needs of all lanes lies side by side. ``channels`` is a
tuple with one entry, of any value, per channel: its *length* belongs to its type, so that nothing is left of the
branches that depend on it.

Classic steps and bands: Sakoe and Chiba 1978, doi:10.1109/TASSP.1978.1163055; skipping steps: Zhang 2021 (Hangzhou
Dianzi University), section 3.1.2; open ends: Sakurai et al. 2007, doi:10.1109/ICDE.2007.368963.
"""

from numba import njit

from app.engine.kernels.lanes import LANES, add, add_cost, load, minimum, splat, store, unreachable


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy", inline="always")
def _query(q, i, k, shift, g, c):
    """Channel ``k`` of point ``i`` in all lanes, with what window group ``g`` adds to it."""
    if shift is None:
        return splat(q, q[i, k])
    return add(splat(q, q[i, k]), load(shift, (g * c + k) * LANES))


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy", inline="always")
def _matched(total, q0, q1, q2, x, at, c):
    """``total`` plus the cost of a point of the query and the map's from offset ``at`` on."""
    total = add_cost(total, q0, load(x, at))
    if c > 1:
        total = add_cost(total, q1, load(x, at + LANES))
    if c > 2:
        total = add_cost(total, q2, load(x, at + 2 * LANES))
    return total


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def classic_windows(q, x, stride, m, lo, hi, channels, shift, row, out):
    """Cost of warping the query onto each window, both ends fixed, with classic steps.

    Parameters
    ----------
    q : (n, channels)
    x : (positions, channels, LANES) of the type of ``q``
    stride : positions from one group of windows to the next: ``m`` where they are stored one after another, 1 where
        every position begins one
    m : length of a window
    lo, hi : (n,) first and last position that each point of the query may be matched with; neither ever falls,
        ``lo[0] == 0`` and ``hi[n - 1] == m - 1``
    channels : tuple as long as there are channels
    shift : (groups, channels, LANES), added to the query for each window (uint16: not negative), or None
    row : (m + 1, LANES) scratch
    out : (groups, LANES) output
    """
    n, c = q.shape[0], len(channels)
    k1, k2 = min(1, c - 1), min(2, c - 1)
    big = unreachable(q)
    for g in range(out.shape[0]):
        base = g * stride * c * LANES
        store(row, 0, splat(q, 0))
        for j in range(1, m + 1):
            store(row, j * LANES, big)
        i = 0
        while i < n:
            a, e = lo[i], hi[i]
            q0, q1, q2 = _query(q, i, 0, shift, g, c), _query(q, i, k1, shift, g, c), _query(q, i, k2, shift, g, c)
            diagonal, left = load(row, a * LANES), big
            store(row, a * LANES, big)
            if i + 1 < n and lo[i + 1] == a and hi[i + 1] == e:
                # two rows in one sweep halve the traffic of the row and of the map
                p0, p1 = _query(q, i + 1, 0, shift, g, c), _query(q, i + 1, k1, shift, g, c)
                p2 = _query(q, i + 1, k2, shift, g, c)
                left2 = big
                for j in range(a, e + 1):
                    at = base + j * c * LANES
                    up = load(row, (j + 1) * LANES)
                    cost = _matched(minimum(minimum(up, diagonal), left), q0, q1, q2, x, at, c)
                    left2 = _matched(minimum(minimum(left, left2), cost), p0, p1, p2, x, at, c)
                    store(row, (j + 1) * LANES, left2)
                    diagonal, left = up, cost
                i += 2
            else:
                for j in range(a, e + 1):
                    up = load(row, (j + 1) * LANES)
                    left = minimum(minimum(up, diagonal), left)
                    left = _matched(left, q0, q1, q2, x, base + j * c * LANES, c)
                    store(row, (j + 1) * LANES, left)
                    diagonal = up
                i += 1
        store(out, g * LANES, load(row, m * LANES))


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def skipping_windows(q, x, stride, m, lo, hi, channels, shift, row, out):
    """As :func:`classic_windows` with skipping steps; ``row`` is (m + 2, LANES)."""
    n, c = q.shape[0], len(channels)
    k1, k2 = min(1, c - 1), min(2, c - 1)
    big = unreachable(q)
    for g in range(out.shape[0]):
        base = g * stride * c * LANES
        for j in range(m + 2):
            store(row, j * LANES, big)
        store(row, LANES, splat(q, 0))  # the point before both beginnings, one step on the diagonal away
        for i in range(n):
            a, e = lo[i], hi[i]
            if i == 0:
                e = 0
            q0, q1, q2 = _query(q, i, 0, shift, g, c), _query(q, i, k1, shift, g, c), _query(q, i, k2, shift, g, c)
            back2, back1 = load(row, a * LANES), load(row, (a + 1) * LANES)
            store(row, a * LANES, big)
            store(row, (a + 1) * LANES, big)
            for j in range(a, e + 1):
                here = load(row, (j + 2) * LANES)
                cost = minimum(minimum(here, back1), back2)
                store(row, (j + 2) * LANES, _matched(cost, q0, q1, q2, x, base + j * c * LANES, c))
                back2, back1 = back1, here
        store(out, g * LANES, load(row, (m + 1) * LANES))


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def classic_subsequence(q, x, channels, column, out):
    """Cost of the best warping of the query that ends at each position and begins anywhere, with classic steps.

    Parameters
    ----------
    q : (n, channels)
    x : (positions, channels, LANES) of the type of ``q``, an even number of positions
    channels : tuple as long as there are channels
    column : (n, LANES), unreachable at first; then left as the next positions need it
    out : (positions, LANES) output
    """
    n, c = q.shape[0], len(channels)
    k1, k2 = min(1, c - 1), min(2, c - 1)
    for j in range(0, x.shape[0], 2):
        at = j * c * LANES
        on = at + c * LANES
        back, here, ahead = splat(q, 0), splat(q, 0), splat(q, 0)  # D(i-1, j-1), D(i-1, j), D(i-1, j+1)
        for i in range(n):  # two positions in one sweep
            q0, q1, q2 = splat(q, q[i, 0]), splat(q, q[i, k1]), splat(q, q[i, k2])
            left = load(column, i * LANES)
            cost = _matched(minimum(minimum(back, left), here), q0, q1, q2, x, at, c)
            ahead = _matched(minimum(minimum(here, ahead), cost), q0, q1, q2, x, on, c)
            store(column, i * LANES, ahead)
            back, here = left, cost
        store(out, j * LANES, here)
        store(out, (j + 1) * LANES, ahead)


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def skipping_subsequence(q, x, channels, uneven, columns, out):
    """As :func:`classic_subsequence` with skipping steps; ``columns`` is (n, 2, LANES).

    ``uneven`` is added for each step by which the map does not go on by exactly one point: without it, a long query
    finds a cheap crooked path nearly everywhere.
    """
    n, c = q.shape[0], len(channels)
    k1, k2 = min(1, c - 1), min(2, c - 1)
    dear = splat(q, uneven)
    for j in range(0, x.shape[0], 2):
        at = j * c * LANES
        on = at + c * LANES
        back2, back1, here, ahead = splat(q, 0), splat(q, 0), splat(q, 0), splat(q, 0)
        for i in range(n):
            q0, q1, q2 = splat(q, q[i, 0]), splat(q, q[i, k1]), splat(q, q[i, k2])
            old2, old1 = load(columns, 2 * i * LANES), load(columns, (2 * i + 1) * LANES)
            crooked = add(minimum(back1, ahead), dear)
            ahead = _matched(minimum(crooked, here), q0, q1, q2, x, on, c)
            crooked = add(minimum(here, back2), dear)
            here = _matched(minimum(crooked, back1), q0, q1, q2, x, at, c)
            store(columns, 2 * i * LANES, here)
            store(columns, (2 * i + 1) * LANES, ahead)
            back2, back1 = old2, old1
        store(out, j * LANES, here)
        store(out, (j + 1) * LANES, ahead)
