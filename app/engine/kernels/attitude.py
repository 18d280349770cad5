"""Tilt and free-azimuth heading from gyroscope and accelerometer.

Symbols: ``q`` rotation of the body frame into a level frame of arbitrary azimuth (scalar first), ``up`` the level
frame's vertical seen from the body, ``psi`` heading of the body's forward axis in that frame.
"""

import numpy as np
from numba import njit


@njit(cache=True, nogil=True, fastmath=False, error_model="numpy")
def level(t, mag, acc, gyro, q, last, gain, out):
    """Integrate attitude over samples; complementary correction of tilt only.

    Parameters
    ----------
    t : (n,) s; mag, acc, gyro : (n, 3)
    q : (4,) attitude at ``last[0]``, updated in place
    last : (2,) time of the previous sample (s) and unwrapped heading psi (rad), updated in place
    gain : 1/s, rate at which tilt is drawn to the accelerometer's vertical
    out : (n, 5) forward, left, up field (uT); psi (rad); vertical specific force (m/s^2)
    """
    n = t.shape[0]
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
        gx, gy, gz = gyro[i, 0], gyro[i, 1], gyro[i, 2]
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
        # forward axis: the top edge, or, with the phone upright, the way its back looks
        fx = 2.0 * (x * y - w * z)
        fy = 1.0 - 2.0 * (x * x + z * z)
        if fx * fx + fy * fy < 0.25:
            fx = -2.0 * (x * z + w * y)
            fy = -2.0 * (y * z - w * x)
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
    q[0], q[1], q[2], q[3] = w, x, y, z
    last[0] = t0
    last[1] = psi
