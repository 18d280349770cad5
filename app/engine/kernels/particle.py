"""One step of the bias-aware particle filter, fused: move, compare with the map, weight, resample.

Rows of a particle array ``p`` (15, n) float32:

== =============================================================================
0  x, m, level frame
1  y, m
2  cos of the device's heading
3  sin of it
4  stride scale
5  carry: device heading minus direction of motion, rad
6  field offset of channel 0, uT, device frame (posterior mean)
7  of channel 1
8  of channel 2
9  previous residual of channel 0, uT
10 of channel 1
11 of channel 2
12 variance of offsets 0 and 1, uT^2
13 variance of offset 2
14 weight
== =============================================================================

The map ``grid`` (rows, columns, 7) float32 holds the three channels' mean, the map's variance of channels 0 and 1,
that of channel 2, 1 where mapped, and the weight of standing there (1 where people can walk). Channels: vector x y z;
``hv`` h - v; total - - f.

The parts of a step are inlined: a callee of its own may be linked in another optimised form when it comes from the
cache than when it was just compiled, and with fast math the two differ in the last bits. Replays must not.
"""

import numpy as np
from numba import njit

ROWS = 15
VECTOR, HV, TOTAL = 0, 1, 2


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy", inline="always")
def move(p, motion, par, pool, offset):
    """Move all particles by one step; see :func:`step` for the arguments."""
    n = p.shape[1]
    c1, s1 = np.float32(np.cos(motion[0])), np.float32(np.sin(motion[0]))
    c2, s2 = np.float32(np.cos(motion[1])), np.float32(np.sin(motion[1]))
    stride = np.float32(motion[2])
    turn_sd, stride_sd = np.float32(par[1]), np.float32(par[2])
    scale_sd, carry_sd, jitter = np.float32(par[3]), np.float32(par[4]), np.float32(par[5])
    one, half = np.float32(1.0), np.float32(0.5)
    n0 = pool[offset : offset + n]
    n1 = pool[offset + n : offset + 2 * n]
    n2 = pool[offset + 2 * n : offset + 3 * n]
    n3 = pool[offset + 3 * n : offset + 4 * n]
    X, Y, C, S, K, A = p[0], p[1], p[2], p[3], p[4], p[5]
    for i in range(n):  # small-angle rotations keep the loop free of trigonometry, so it vectorizes
        d = turn_sd * n0[i]
        cd, sd = one - half * d * d, d
        c, s = C[i], S[i]
        a = A[i] + carry_sd * n3[i]
        A[i] = a
        ca, sa = one - half * a * a, a - a * a * a * np.float32(1.0 / 6.0)
        mc, ms = c * c1 - s * s1, s * c1 + c * s1
        k = K[i] + scale_sd * n2[i]
        K[i] = k
        length = stride * k * (one + stride_sd * n1[i])
        X[i] += length * (mc * ca + ms * sa) + jitter * n3[n - 1 - i]
        Y[i] += length * (ms * ca - mc * sa) + jitter * n2[n - 1 - i]
        ec, es = c * c2 - s * s2, s * c2 + c * s2
        ec, es = ec * cd - es * sd, es * cd + ec * sd
        g = np.float32(1.5) - half * (ec * ec + es * es)  # one Newton step back to unit length
        C[i], S[i] = ec * g, es * g


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy", inline="always")
def bilinear(grid, layer, ix, iy, fx, fy):
    """Value of a layer at node ``(iy, ix)`` and the fractions beyond it."""
    w11 = fx * fy
    w01, w10 = fx - w11, fy - w11
    w00 = np.float32(1.0) - fx - w10
    return (
        w00 * grid[iy, ix, layer]
        + w01 * grid[iy, ix + 1, layer]
        + w10 * grid[iy + 1, ix, layer]
        + w11 * grid[iy + 1, ix + 1, layer]
    )


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy", inline="always")
def whitening(map_var, noise_var, rho_map, rho_noise):
    """Variance of a residual, what is new of a constant in the whitened one (``1 - rho``), and the white share.

    The map's error and the noise about it are alike over different lengths: unmapped ground is wrong for longer.
    """
    var = map_var + noise_var
    rho = (map_var * rho_map + noise_var * rho_noise) / var
    return var * (np.float32(1.0) - rho * rho), np.float32(1.0) - rho, rho


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy", inline="always")
def weigh(p, grid, motion, z, par, mode, first):
    """Compare all particles with the map and multiply their weights; returns the weights' sum."""
    n = p.shape[1]
    x0, y0, inv_cell = np.float32(motion[3]), np.float32(motion[4]), np.float32(par[0])
    wx, wy = np.float32(grid.shape[1] - 1.001), np.float32(grid.shape[0] - 1.001)
    noise_h, noise_v = np.float32(par[6]), np.float32(par[7])
    inv_dof, drift = np.float32(1.0 / par[9]), np.float32(par[11])
    rho_noise = np.float32(0.0) if first else np.float32(np.exp(-max(motion[2], 0.01) * par[8]))
    rho_map = np.float32(0.0) if first else np.float32(np.exp(-max(motion[2], 0.01) * par[12]))
    z0, z1, z2 = np.float32(z[0]), np.float32(z[1]), np.float32(z[2])
    zero, one, half = np.float32(0.0), np.float32(1.0), np.float32(0.5)
    X, Y, C, S = p[0], p[1], p[2], p[3]
    B0, B1, B2, R0, R1, R2, PH, PV, W = p[6], p[7], p[8], p[9], p[10], p[11], p[12], p[13], p[14]
    total = 0.0
    for i in range(n):
        gx = min(max((X[i] - x0) * inv_cell, zero), wx)
        gy = min(max((Y[i] - y0) * inv_cell, zero), wy)
        ix, iy = np.int32(gx), np.int32(gy)
        fx, fy = gx - np.float32(ix), gy - np.float32(iy)
        jx, jy = np.int32(gx + half), np.int32(gy + half)
        var, fresh, rho = whitening(grid[jy, jx, 4], noise_v, rho_map, rho_noise)
        var += fresh * fresh * PV[i]
        r = z2 - bilinear(grid, 2, ix, iy, fx, fy)
        e = r - rho * R2[i] - fresh * B2[i]
        inv = one / var
        quad = e * e * inv
        scale = np.sqrt(inv)
        gain = fresh * PV[i] * inv
        B2[i] += gain * e
        PV[i] += drift - gain * fresh * PV[i]
        R2[i] = r
        if mode != 2:
            var, fresh, rho = whitening(grid[jy, jx, 3], noise_h, rho_map, rho_noise)
            var += fresh * fresh * PH[i]
            inv = one / var
            gain = fresh * PH[i] * inv
            PH[i] += drift - gain * fresh * PH[i]
            m0 = bilinear(grid, 0, ix, iy, fx, fy)
            if mode == 0:
                # the map's horizontal field turned into the device's frame
                m1 = bilinear(grid, 1, ix, iy, fx, fy)
                r = z1 - (C[i] * m1 - S[i] * m0)
                e = r - rho * R1[i] - fresh * B1[i]
                quad += e * e * inv
                B1[i] += gain * e
                R1[i] = r
                m0 = C[i] * m0 + S[i] * m1
                scale *= np.sqrt(inv)
            r = z0 - m0
            e = r - rho * R0[i] - fresh * B0[i]
            quad += e * e * inv
            B0[i] += gain * e
            R0[i] = r
            scale *= np.sqrt(inv)
        # Student t with 8 - d degrees of freedom in d dimensions: the exponent is 4 in every mode
        t = one + quad * inv_dof
        t *= t
        w = W[i] * bilinear(grid, 6, ix, iy, fx, fy) * scale / (t * t)
        W[i] = w
        total += w
    return total


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy", inline="always")
def summarize(p, grid, motion, par, total, est):
    """Normalize the weights (equal ones if none is left) and sum up; see ``est`` of :func:`step`."""
    n = p.shape[1]
    x0, y0, inv_cell = np.float32(motion[3]), np.float32(motion[4]), np.float32(par[0])
    wx, wy = np.float32(grid.shape[1] - 1.001), np.float32(grid.shape[0] - 1.001)
    zero, half = np.float32(0.0), np.float32(0.5)
    X, Y, C, S, A, W = p[0], p[1], p[2], p[3], p[5], p[14]
    est[:] = 0.0
    est[0] = total
    lost = not total > 0.0
    inv = np.float32(1.0) if lost else np.float32(1.0 / total)
    xr, yr = X[0], Y[0]
    for i in range(n):  # moments about the first particle: float32 sums of squares of large coordinates cancel
        w = np.float32(1.0 / n) if lost else W[i] * inv
        W[i] = w
        dx, dy = X[i] - xr, Y[i] - yr
        est[1] += w * dx
        est[2] += w * dy
        est[3] += w * dx * dx
        est[4] += w * dx * dy
        est[5] += w * dy * dy
        est[6] += w * (C[i] + S[i] * A[i])
        est[7] += w * (S[i] - C[i] * A[i])
        jx = np.int32(min(max((X[i] - x0) * inv_cell, zero), wx) + half)
        jy = np.int32(min(max((Y[i] - y0) * inv_cell, zero), wy) + half)
        est[8] += w * grid[jy, jx, 5]
        est[9] += w * w
    mx, my = est[1], est[2]
    est[3] -= mx * mx
    est[4] -= mx * my
    est[5] -= my * my
    est[1] += xr
    est[2] += yr


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy", inline="always")
def resample(p, q, u, ancestor):
    """Systematic resampling of ``p`` into ``q`` with equal weights."""
    n = p.shape[1]
    W = p[14]
    k = 0
    c0 = np.float64(W[0])
    target = u / n
    for i in range(n):
        while c0 < target and k < n - 1:
            k += 1
            c0 += W[k]
        ancestor[i] = k
        for r in range(14):
            q[r, i] = p[r, k]
        q[14, i] = np.float32(1.0 / n)
        target += 1.0 / n


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def step(p, q, grid, motion, z, par, mode, first, pool, offset, u, est, ancestor):
    """Advance all particles by one step of the walker.

    Parameters
    ----------
    p, q : (15, n) particles, and scratch of the same shape
    grid : (rows, columns, 7) map
    motion : (5,) turn until the mid of the step (rad), turn until its end, stride (m), origin x, origin y (m)
    z : (3,) measured channels (forward, left, up / h, -, v / -, -, total), uT
    par : (13,) 1/cell, heading noise (rad), stride noise (share), scale walk, carry walk (rad), position noise (m),
        noise variance of channels 0 and 1, of channel 2, 1/correlation length (1/m), t distribution's degrees of
        freedom, share of effective particles below which to resample, offset walk (uT^2), 1/correlation length of the
        map's own error (1/m)
    mode : VECTOR, HV or TOTAL
    first : True when there is no previous residual
    pool, offset : standard normals, and where to begin in them (4 n are used)
    u : uniform in [0, 1) for systematic resampling
    est : (10,) output: what is left of the weights (the step's likelihood); then, of the normalized ones, sums of w x,
        w y, w x^2, w x y, w y^2, w cos, w sin of the motion, w mapped, w^2

    ancestor : (n,) output, where each particle of ``q`` stood in ``p``; only written when resampled

    Returns
    -------
    True when the particles were resampled (the result is then in ``q``).
    """
    move(p, motion, par, pool, offset)
    total = weigh(p, grid, motion, z, par, mode, first)
    summarize(p, grid, motion, par, total, est)
    if est[9] * p.shape[1] * par[10] < 1.0:
        return False
    resample(p, q, u, ancestor)
    return True
