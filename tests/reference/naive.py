"""Slow twins of the kernels: obviously right, in plain numpy and Python."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation


def level(t, mag, acc, gyro, moving, rotation, t0, heading, rest, par):
    """Attitude with rotation vectors in place of quaternion increments. Returns (n, 8) as the kernel."""
    gain, mean_s, gyro_var, rate_max, acc_var, settle_s, learn_s = par
    offset, mean_gyro, var_gyro, mean_acc, var_acc, at_rest = (
        rest[0:3].copy(), rest[3:6].copy(), rest[6], rest[7:10].copy(), rest[10], rest[11]
    )  # fmt: skip
    out = np.empty((len(t), 8))
    for i in range(len(t)):
        dt = t[i] - t0
        a = 1.0 - np.exp(-dt / mean_s)
        var_gyro = (1 - a) * var_gyro + a * np.sum((gyro[i] - mean_gyro) ** 2)
        var_acc = (1 - a) * var_acc + a * np.sum((acc[i] - mean_acc) ** 2)
        mean_gyro = (1 - a) * mean_gyro + a * gyro[i]
        mean_acc = (1 - a) * mean_acc + a * acc[i]
        quiet = var_gyro < gyro_var and np.linalg.norm(mean_gyro) < rate_max and var_acc < acc_var
        at_rest = at_rest + dt if quiet and not moving[i] else 0.0
        if at_rest > settle_s:
            keep = np.exp(-dt / learn_s)
            offset = keep * offset + (1 - keep) * gyro[i]
        up = rotation.inv().apply([0.0, 0.0, 1.0])
        rate = gyro[i] - offset
        norm = np.linalg.norm(acc[i])
        if norm > 1.0:
            rate += gain / (1.0 + ((norm - 9.81) / 2.0) ** 2) * np.cross(acc[i] / norm, up)
        rotation = rotation * Rotation.from_rotvec(rate * dt)
        t0 = t[i]
        up = rotation.inv().apply([0.0, 0.0, 1.0])
        forward = rotation.apply([0.0, 1.0, 0.0])
        if np.hypot(forward[0], forward[1]) < 0.5:
            forward = rotation.apply([0.0, 0.0, -1.0 if up[1] > 0 else 1.0])
        turn = np.arctan2(forward[1], forward[0]) - heading
        heading += turn - 2.0 * np.pi * np.floor(turn / (2.0 * np.pi) + 0.5)
        m = rotation.apply(mag[i])
        out[i, 0] = np.cos(heading) * m[0] + np.sin(heading) * m[1]
        out[i, 1] = -np.sin(heading) * m[0] + np.cos(heading) * m[1]
        out[i, 2] = m[2]
        out[i, 3] = heading
        out[i, 4] = rotation.apply(acc[i])[2]
        out[i, 5:] = up
    return out


def matern(d, length):
    """Matern 3/2 correlation."""
    a = np.sqrt(3.0) * d / length
    return (1.0 + a) * np.exp(-a)


def nested(d, covariance):
    """Correlation of a coarse and a fine field."""
    coarse, fine = matern(d, covariance.length_m), matern(d, covariance.fine_length_m)
    return (1.0 - covariance.fine) * coarse + covariance.fine * fine


def isotropic(xy, covariance):
    """Places in the plane where the field has no preferred direction."""
    angle, s = covariance.stretch_angle, np.sqrt(covariance.stretch)
    along, across = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
    return np.outer(xy @ along, along) / s + np.outer(xy @ across, across) * s


def sample_noise(xy, walk, error, white, covariance):
    """Covariance of what samples differ from the field by."""
    d = np.linalg.norm(xy[:, None] - xy[None], axis=-1)
    own = (walk[:, None] == walk[None]) * np.exp(-d / covariance.error_length_m)
    return np.outer(error, error) * own + np.diag(white)


def krige(xy, walk, z, error, white, nodes, covariance):
    """Simple kriging with all samples by a dense solve; mean (m, channels) and variance (m,) in units of the sill."""
    xy, nodes = isotropic(xy, covariance), isotropic(nodes, covariance)
    k = nested(np.linalg.norm(xy[:, None] - xy[None], axis=-1), covariance)
    k += sample_noise(xy, walk, error, white, covariance)
    b = nested(np.linalg.norm(nodes[:, None] - xy[None], axis=-1), covariance)
    weights = np.linalg.solve(k, b.T).T
    return weights @ z, 1.0 - np.sum(weights * b, axis=1)


def potential(lag, covariance):
    """Covariance of the potential whose gradient has the nested Matern 3/2 as the mean of its components'."""
    d = np.linalg.norm(isotropic(lag, covariance), axis=-1)
    total = 0.0
    for share, length in (
        (1.0 - covariance.fine, covariance.length_m),
        (covariance.fine, covariance.fine_length_m),
    ):
        a = np.sqrt(3.0) / length
        # Matern 5/2 with the variance that makes the slope's variance one: (1 + x + x^2 / 3) exp(-x) * 3 / a^2
        x = a * d
        total = total + share * 3.0 / a**2 * (1.0 + x + x**2 / 3.0) * np.exp(-x)
    return total


def gradient_covariance(lags, covariance, h=1e-3):
    """Covariance (m, 2, 2) of the gradient of the potential at two places, by central differences of its covariance."""
    steps = h * np.eye(2)
    out = np.empty((len(lags), 2, 2))
    for i in range(2):
        for j in range(2):
            # d/dx_i d/dx'_j k(x - x') = -k_ij(lag)
            out[:, i, j] = -(
                potential(lags + steps[i] + steps[j], covariance)
                - potential(lags + steps[i] - steps[j], covariance)
                - potential(lags - steps[i] + steps[j], covariance)
                + potential(lags - steps[i] - steps[j], covariance)
            ) / (4.0 * h**2)  # fmt: skip
    return out


def krige_gradient(xy, walk, z, error, white, nodes, covariance):
    """Kriging of a gradient's two components with all samples: mean and variance (m, 2)."""
    n, m = len(xy), len(nodes)

    def between(a, b):
        lags = (a[:, None] - b[None]).reshape(-1, 2)
        blocks = gradient_covariance(lags, covariance).reshape(len(a), len(b), 2, 2)
        return blocks.transpose(2, 0, 3, 1).reshape(2 * len(a), 2 * len(b))

    noise = sample_noise(isotropic(xy, covariance), walk, error, white, covariance)
    k = between(xy, xy) + np.kron(np.eye(2), noise)
    b = between(nodes, xy)
    weights = np.linalg.solve(k, b.T).T
    sill = np.diag(gradient_covariance(np.zeros((1, 2)), covariance)[0])
    variance = np.repeat(sill, m) - np.sum(weights * b, axis=1)
    return (weights @ z.T.reshape(2 * n)).reshape(2, m).T, variance.reshape(2, m).T


def spread_out(xy, walk, near, spacing, k):
    """Half of a neighbourhood nearest first, then but for walks with a sample close by; then the nearest others."""
    chosen = list(near[: k // 2])
    for a in near[k // 2 :]:
        close = [b for b in chosen if walk[b] == walk[a] and np.hypot(*(xy[a] - xy[b])) < spacing]
        if len(chosen) < k and not close:
            chosen.append(a)
    rest = [a for a in near if a not in chosen]
    return chosen + rest[: k - len(chosen)]


def bilinear(plane, gx, gy):
    """Value of a plane at fractional column gx and row gy, clamped to its edge."""
    rows, columns = plane.shape
    gx, gy = np.clip(gx, 0, columns - 1.001), np.clip(gy, 0, rows - 1.001)
    ix, iy = int(gx), int(gy)
    fx, fy = gx - ix, gy - iy
    top = plane[iy, ix] * (1 - fx) + plane[iy, ix + 1] * fx
    bottom = plane[iy + 1, ix] * (1 - fx) + plane[iy + 1, ix + 1] * fx
    return top * (1 - fy) + bottom * fy


def nearest(plane, gx, gy):
    """Value of the nearest node."""
    rows, columns = plane.shape
    return plane[int(np.clip(gy, 0, rows - 1.001) + 0.5), int(np.clip(gx, 0, columns - 1.001) + 0.5)]


def particle_step(p, grid, motion, z, par, mode, first, normals, u):
    """One particle after the other, with trigonometry and matrices. ``normals`` (4, n).

    Returns weighted particles, moments (as the kernel's ``est``) and resampling indices (None if not resampled).
    """
    p = p.astype(float).copy()
    n = p.shape[1]
    turn_mid, turn, stride, x0, y0 = motion
    cell = 1.0 / par[0]
    rho_noise, rho_map = (0.0, 0.0) if first else (np.exp(-stride * par[8]), np.exp(-stride * par[12]))
    for i in range(n):
        x, y, c, s, scale, carry = p[:6, i]
        n0, n1, n2, n3 = normals[:, i]
        heading = np.arctan2(s, c)
        carry += par[4] * n3
        scale += par[3] * n2
        length = stride * scale * (1.0 + par[2] * n1)
        x += length * np.cos(heading + turn_mid - carry) + par[5] * normals[3, n - 1 - i]
        y += length * np.sin(heading + turn_mid - carry) + par[5] * normals[2, n - 1 - i]
        heading += turn + par[1] * n0
        p[:6, i] = x, y, np.cos(heading), np.sin(heading), scale, carry
        gx, gy = (x - x0) / cell, (y - y0) / cell
        m = np.array([bilinear(grid[..., k], gx, gy) for k in range(3)])
        own = np.array([nearest(grid[..., 3], gx, gy)] * 2 + [nearest(grid[..., 4], gx, gy)])
        noise = np.array([par[6], par[6], par[7]])
        var = own + noise
        rhos = (own * rho_map + noise * rho_noise) / var
        if mode == 0:
            c, s = np.cos(heading), np.sin(heading)
            m = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) @ m
            used = [0, 1, 2]
        else:
            used = [0, 2] if mode == 1 else [2]
        weight = bilinear(grid[..., 6], gx, gy)
        quad = 0.0
        for k in used:
            row = 13 if k == 2 else 12
            spread = p[row, i]
            residual = z[k] - m[k]
            rho = rhos[k]
            fresh, white = 1.0 - rho, 1.0 - rho**2
            innovation = residual - rho * p[9 + k, i] - fresh * p[6 + k, i]
            total = var[k] * white + fresh**2 * spread
            quad += innovation**2 / total
            weight /= np.sqrt(total)
            p[6 + k, i] += fresh * spread / total * innovation
            p[9 + k, i] = residual
        for row in {13 if k == 2 else 12 for k in used}:
            k = 2 if row == 13 else 0
            fresh = 1.0 - rhos[k]
            total = var[k] * (1.0 - rhos[k] ** 2) + fresh**2 * p[row, i]
            p[row, i] += par[11] - fresh**2 * p[row, i] ** 2 / total
        p[14, i] *= weight / (1.0 + quad / par[9]) ** 4
    likelihood = p[14].sum()
    p[14] /= likelihood
    w = p[14]
    mean = np.array([w @ p[0], w @ p[1]])
    d = p[:2] - mean[:, None]
    cov = (w * d) @ d.T
    direction = np.arctan2(p[3], p[2]) - p[5]
    mapped = sum(w[i] * nearest(grid[..., 5], (p[0, i] - x0) / cell, (p[1, i] - y0) / cell) for i in range(n))
    moments = np.array(
        [
            likelihood,
            *mean,
            cov[0, 0],
            cov[0, 1],
            cov[1, 1],
            w @ np.cos(direction),
            w @ np.sin(direction),
            mapped,
            w @ w,
        ]
    )
    if moments[9] * n * par[10] < 1.0:
        return p, moments, None
    return p, moments, np.searchsorted(np.cumsum(w), (np.arange(n) + u) / n)


def steps(t, vertical, smooth_s, peak_s, swing_s, min_swing, min_interval_s, settle_s):
    """Steps by looking at every sample with full windows."""
    smooth = np.array(
        [
            0.5 * vertical[np.abs(t - at) <= smooth_s + 1e-9].mean()
            + 0.5 * vertical[np.abs(t - at) <= smooth_s / 2 + 1e-9].mean()
            for at in t
        ]
    )
    found = []
    for i in range(1, len(t) - 1):
        if not (smooth[i] >= smooth[i - 1] and smooth[i] > smooth[i + 1]):
            continue
        if t[i] > t[-1] - settle_s or (found and t[i] < found[-1] + min_interval_s):
            continue
        around = (t >= t[i] - peak_s) & (t <= t[i] + peak_s)
        before = (t >= t[i] - swing_s) & (t <= t[i])
        if smooth[i] >= smooth[around].max() and smooth[i] - smooth[before].min() >= min_swing:
            found.append(t[i])
    return np.array(found)


def pauta_means(values, lo, hi):
    """Means of windows without what lies beyond three standard deviations of the window."""
    means = []
    for a, b in zip(lo, hi, strict=True):
        window = values[a:b]
        far = np.abs(window - window.mean(axis=0)) > 3.0 * window.std(axis=0) + 1e-12
        means.append(np.nanmean(np.where(far, np.nan, window), axis=0))
    return np.array(means)


def record_lines(x, y, x0, y0):
    """Centimetres from the reference, rounded half to even, at most 327.67 m."""
    return np.clip(np.rint(100.0 * np.stack([x - x0, y - y0], axis=1)), -32767, 32767).astype(np.int16)


def line_moments(xy, w):
    """Mean and covariance by the definition, the mean taken off first."""
    metres = xy / 100.0
    mean = np.average(metres, axis=0, weights=w)
    cov = np.cov(metres.T, aweights=w, ddof=0)
    return np.array([*mean, cov[0, 0], cov[0, 1], cov[1, 1]])


def placements(planes, mapped, points, values, poses, squared, centred, turning):
    """Cost and mapped share of placements, point after point, shape (p, 2)."""
    channels, rows, columns = planes.shape
    planes = np.pad(planes.astype(float), ((0, 0), (0, 1), (0, 1)), mode="edge")
    out = []
    for x, y, angle, scale in poses:
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        residuals = []
        for point, value in zip(points, values, strict=True):
            gx, gy = np.array([x, y]) + scale * turn @ point
            if not (0 <= gx <= columns - 1 and 0 <= gy <= rows - 1):
                continue
            if not mapped[int(np.ceil(gy - 0.5)), int(np.ceil(gx - 0.5))]:
                continue
            if turning:
                value = np.concatenate([turn @ value[:2], value[2:]])
            residuals.append([value[c] - bilinear_open(planes[c], gx, gy) for c in range(channels)])
        d = np.array(residuals).reshape(-1, channels)
        if centred and len(d):
            d = d - d.mean(axis=0)
        cost = (d**2 if squared else np.abs(d)).mean() if len(d) else 0.0
        out.append([cost, len(d) / len(points)])
    return np.array(out)


def bilinear_open(plane, gx, gy):
    """Value of a plane that has one row and column more than is ever reached."""
    ix, iy = int(np.floor(gx)), int(np.floor(gy))
    fx, fy = gx - ix, gy - iy
    top = plane[iy, ix] * (1 - fx) + plane[iy, ix + 1] * fx
    bottom = plane[iy + 1, ix] * (1 - fx) + plane[iy + 1, ix + 1] * fx
    return top * (1 - fy) + bottom * fy


def lattice(plane, weight, offset, i, j, v, u, z, shape):
    """Map, weight and reading of each point at each shift, shift after shift: three arrays (rows, columns, n)."""
    s, w = np.empty((*shape, len(z))), np.empty((*shape, len(z)))
    for y, x in np.ndindex(shape):
        for k in range(len(z)):
            s[y, x, k] = (
                bilinear_open(plane.astype(float), j[k] + x + float(u[k]), i[k] + y + float(v[k])) + offset[y, x]
            )
            w[y, x, k] = weight[i[k] + y + (v[k] > 0.5), j[k] + x + (u[k] > 0.5)]
    return s, w, np.broadcast_to(z, s.shape)
