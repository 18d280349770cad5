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
"""

import numpy as np
from numba import njit

ROWS = 15
VECTOR, HV, TOTAL = 0, 1, 2


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
    est : (10,) output: sums of w, w x, w y, w x^2, w x y, w y^2, w cos, w sin of the motion, w mapped, w^2 / (sum w)^2

    ancestor : (n,) output, where each particle of ``q`` stood in ``p``; only written when resampled

    Returns
    -------
    True when the particles were resampled (the result is then in ``q``).
    """
    n = p.shape[1]
    rows, columns = grid.shape[0], grid.shape[1]
    c1, s1 = np.float32(np.cos(motion[0])), np.float32(np.sin(motion[0]))
    c2, s2 = np.float32(np.cos(motion[1])), np.float32(np.sin(motion[1]))
    stride = np.float32(motion[2])
    x0, y0 = np.float32(motion[3]), np.float32(motion[4])
    inv_cell, turn_sd, stride_sd = np.float32(par[0]), np.float32(par[1]), np.float32(par[2])
    scale_sd, carry_sd, jitter = np.float32(par[3]), np.float32(par[4]), np.float32(par[5])
    noise_h, noise_v = np.float32(par[6]), np.float32(par[7])
    rho_noise = np.float32(0.0) if first else np.float32(np.exp(-max(motion[2], 0.01) * par[8]))
    rho_map = np.float32(0.0) if first else np.float32(np.exp(-max(motion[2], 0.01) * par[12]))
    inv_dof = np.float32(1.0 / par[9])
    drift = np.float32(par[11])
    one, half = np.float32(1.0), np.float32(0.5)
    z0, z1, z2 = np.float32(z[0]), np.float32(z[1]), np.float32(z[2])
    wx, wy = np.float32(columns - 1.001), np.float32(rows - 1.001)
    zero = np.float32(0.0)
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
        g = np.float32(1.5) - half * (ec * ec + es * es)
        C[i], S[i] = ec * g, es * g
    B0, B1, B2, R0, R1, R2, PH, PV, W = p[6], p[7], p[8], p[9], p[10], p[11], p[12], p[13], p[14]
    total = 0.0
    for i in range(n):
        gx = min(max((X[i] - x0) * inv_cell, zero), wx)
        gy = min(max((Y[i] - y0) * inv_cell, zero), wy)
        ix, iy = np.int32(gx), np.int32(gy)
        fx, fy = gx - np.float32(ix), gy - np.float32(iy)
        w11 = fx * fy
        w01, w10 = fx - w11, fy - w11
        w00 = one - fx - w10
        m0 = (
            w00 * grid[iy, ix, 0]
            + w01 * grid[iy, ix + 1, 0]
            + w10 * grid[iy + 1, ix, 0]
            + w11 * grid[iy + 1, ix + 1, 0]
        )
        m1 = (
            w00 * grid[iy, ix, 1]
            + w01 * grid[iy, ix + 1, 1]
            + w10 * grid[iy + 1, ix, 1]
            + w11 * grid[iy + 1, ix + 1, 1]
        )
        m2 = (
            w00 * grid[iy, ix, 2]
            + w01 * grid[iy, ix + 1, 2]
            + w10 * grid[iy + 1, ix, 2]
            + w11 * grid[iy + 1, ix + 1, 2]
        )
        free = (
            w00 * grid[iy, ix, 6]
            + w01 * grid[iy, ix + 1, 6]
            + w10 * grid[iy + 1, ix, 6]
            + w11 * grid[iy + 1, ix + 1, 6]
        )
        jx, jy = np.int32(gx + half), np.int32(gy + half)
        # the map's error and the noise about it are alike over different lengths: unmapped ground is wrong for longer
        vm = grid[jy, jx, 4]
        vv = vm + noise_v
        rho = (vm * rho_map + noise_v * rho_noise) / vv
        fresh = one - rho
        white = one - rho * rho
        sv = vv * white + fresh * fresh * PV[i]
        scale = one / np.sqrt(sv)
        r2 = z2 - m2
        e2 = r2 - rho * R2[i] - fresh * B2[i]
        quad = e2 * e2 / sv
        gain = fresh * PV[i] / sv
        B2[i] += gain * e2
        PV[i] += drift - gain * fresh * PV[i]
        R2[i] = r2
        if mode != 2:
            vm = grid[jy, jx, 3]
            vh = vm + noise_h
            rho = (vm * rho_map + noise_h * rho_noise) / vh
            fresh = one - rho
            white = one - rho * rho
            sh = vh * white + fresh * fresh * PH[i]
            gain = fresh * PH[i] / sh
            if mode == 0:
                # the map's horizontal field turned into the device's frame
                c, s = C[i], S[i]
                r0 = z0 - (c * m0 + s * m1)
                r1 = z1 - (c * m1 - s * m0)
                e0 = r0 - rho * R0[i] - fresh * B0[i]
                e1 = r1 - rho * R1[i] - fresh * B1[i]
                quad += (e0 * e0 + e1 * e1) / sh
                scale /= sh
                B1[i] += gain * e1
                R1[i] = r1
            else:
                r0 = z0 - m0
                e0 = r0 - rho * R0[i] - fresh * B0[i]
                quad += e0 * e0 / sh
                scale /= np.sqrt(sh)
            B0[i] += gain * e0
            R0[i] = r0
            PH[i] += drift - gain * fresh * PH[i]
        # Student t with 8 - d degrees of freedom in d dimensions: the exponent is 4 in every mode
        t = one + quad * inv_dof
        t *= t
        w = W[i] * free * scale / (t * t)
        W[i] = w
        total += w
    for j in range(10):
        est[j] = 0.0
    inv = np.float32(1.0 / total) if total > 0.0 else one
    squares = 0.0
    xr, yr = X[0], Y[0]
    for i in range(n):  # moments about the first particle: float32 sums of squares of large coordinates cancel
        w = W[i] * inv if total > 0.0 else np.float32(1.0 / n)
        W[i] = w
        dx, dy = X[i] - xr, Y[i] - yr
        est[0] += w
        est[1] += w * dx
        est[2] += w * dy
        est[3] += w * dx * dx
        est[4] += w * dx * dy
        est[5] += w * dy * dy
        a = A[i]
        est[6] += w * (C[i] + S[i] * a)
        est[7] += w * (S[i] - C[i] * a)
        jx = np.int32(min(max((X[i] - x0) * inv_cell, zero), wx) + half)
        jy = np.int32(min(max((Y[i] - y0) * inv_cell, zero), wy) + half)
        est[8] += w * grid[jy, jx, 5]
        squares += w * w
    est[9] = squares
    mx, my = est[1], est[2]
    est[3] -= mx * mx
    est[4] -= mx * my
    est[5] -= my * my
    est[1] += xr
    est[2] += yr
    if squares * n * par[10] < 1.0:
        return False
    uniform = np.float32(1.0 / n)
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
        q[14, i] = uniform
        target += 1.0 / n
    return True
