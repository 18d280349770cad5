"""Tilt and free-azimuth heading from gyroscope and accelerometer.

Symbols: ``q`` rotation of the body frame into a level frame of arbitrary azimuth (scalar first), ``up`` the level
frame's vertical seen from the body, ``psi`` heading of the body's forward axis in that frame.

``rest`` (12,) is what tells a device at rest: the gyroscope's offset (0:3, rad/s), running means of its reading (3:6),
of the squared distance from that (6), of the specific force (7:10, m/s^2), of the squared distance from that (10), and
the time at rest so far (11, s).
"""

import numpy as np
from numba import njit


@njit(cache=True, nogil=True, fastmath=False, error_model="numpy")
def level(t, mag, acc, gyro, moving, q, last, rest, par, out):
    """Integrate attitude over samples; complementary correction of tilt only.

    At rest the gyroscope should read nothing: what it reads then is learned as its offset, and taken off from there on.

    Parameters
    ----------
    t : (n,) s; mag, acc, gyro : (n, 3)
    moving : (n,) bool, True where the device is known to move, however smoothly
    q : (4,) attitude at ``last[0]``, updated in place
    last : (2,) time of the previous sample (s) and unwrapped heading psi (rad), updated in place
    rest : (12,) see above, updated in place
    par : (7,) rate at which tilt is drawn to the accelerometer's vertical (1/s), time of the running means (s), bounds
        of rest: variance of the gyroscope ((rad/s)^2), its mean rate (rad/s), variance of the force ((m/s^2)^2); rest
        before the offset is learned (s), and time to learn it (s)
    out : (n, 8) forward, left, up field (uT); psi (rad); vertical specific force (m/s^2); vertical in the body
    """
    n = t.shape[0]
    gain = par[0]
    w, x, y, z = q[0], q[1], q[2], q[3]
    t0 = last[0]
    psi = last[1]
    for i in range(n):
        dt = t[i] - t0
        t0 = t[i]
        # vertical of the level frame in the body: third row of R(q)
        ux = 2.0 * (x * z - w * y)
        uy = 2.0 * (y * z + w * x)
        uz = 1.0 - 2.0 * (x * x + y * y)
        norm = np.sqrt(acc[i, 0] ** 2 + acc[i, 1] ** 2 + acc[i, 2] ** 2)
        a = 1.0 - np.exp(-max(dt, 0.0) / par[1])
        vg, va, mean = 0.0, 0.0, 0.0
        for k in range(3):
            dg, da = gyro[i, k] - rest[3 + k], acc[i, k] - rest[7 + k]
            rest[3 + k] += a * dg
            rest[7 + k] += a * da
            vg += dg * dg
            va += da * da
            mean += rest[3 + k] * rest[3 + k]
        rest[6] += a * (vg - rest[6])
        rest[10] += a * (va - rest[10])
        quiet = rest[6] < par[2] and mean < par[3] * par[3] and rest[10] < par[4] and not moving[i]
        rest[11] = rest[11] + dt if quiet else 0.0
        if rest[11] > par[5]:
            a = 1.0 - np.exp(-dt / par[6])
            for k in range(3):
                rest[k] += a * (gyro[i, k] - rest[k])
        gx, gy, gz = gyro[i, 0] - rest[0], gyro[i, 1] - rest[1], gyro[i, 2] - rest[2]
        if norm > 1.0:
            # far from 1 g the accelerometer tells motion, not vertical
            trust = gain / (1.0 + (abs(norm - 9.81) / 2.0) ** 2) / norm
            gx += trust * (acc[i, 1] * uz - acc[i, 2] * uy)
            gy += trust * (acc[i, 2] * ux - acc[i, 0] * uz)
            gz += trust * (acc[i, 0] * uy - acc[i, 1] * ux)
        hx, hy, hz = 0.5 * dt * gx, 0.5 * dt * gy, 0.5 * dt * gz
        w, x, y, z = (
            w - x * hx - y * hy - z * hz,
            x + w * hx + y * hz - z * hy,
            y + w * hy + z * hx - x * hz,
            z + w * hz + x * hy - y * hx,
        )
        s = 1.0 / np.sqrt(w * w + x * x + y * y + z * z)
        w, x, y, z = w * s, x * s, y * s, z * s
        ux = 2.0 * (x * z - w * y)
        uy = 2.0 * (y * z + w * x)
        uz = 1.0 - 2.0 * (x * x + y * y)
        # forward axis: the top edge; with the phone upright the way its back looks, upside down the way its screen does
        fx = 2.0 * (x * y - w * z)
        fy = 1.0 - 2.0 * (x * x + z * z)
        if fx * fx + fy * fy < 0.25:
            side = -2.0 if uy > 0.0 else 2.0
            fx = side * (x * z + w * y)
            fy = side * (y * z - w * x)
        heading = np.arctan2(fy, fx)
        turn = heading - psi
        psi += turn - 2.0 * np.pi * np.floor(turn / (2.0 * np.pi) + 0.5)
        mx, my, mz = mag[i, 0], mag[i, 1], mag[i, 2]
        ex = (1.0 - 2.0 * (y * y + z * z)) * mx + 2.0 * (x * y - w * z) * my + 2.0 * (x * z + w * y) * mz
        ey = 2.0 * (x * y + w * z) * mx + (1.0 - 2.0 * (x * x + z * z)) * my + 2.0 * (y * z - w * x) * mz
        c, d = np.cos(psi), np.sin(psi)
        out[i, 0] = c * ex + d * ey
        out[i, 1] = -d * ex + c * ey
        out[i, 2] = ux * mx + uy * my + uz * mz
        out[i, 3] = psi
        out[i, 4] = ux * acc[i, 0] + uy * acc[i, 1] + uz * acc[i, 2]
        out[i, 5], out[i, 6], out[i, 7] = ux, uy, uz
    q[0], q[1], q[2], q[3] = w, x, y, z
    last[0] = t0
    last[1] = psi
