"""Position errors of an unaided inertial navigation system: the error model, not the navigator.

Two level channels with Schuler feedback, forced by accelerometer bias and gyro drift that turn with the vehicle::

    dp' = dv,   dv' = b - g psi,   psi' = dv / R + e

with ``dp`` position error (m), ``dv`` velocity error (m/s), ``psi`` tilt (rad, as the direction of the acceleration it
feigns), ``b`` accelerometer error (m/s^2) and ``e`` level gyro error (rad/s), all in the level frame. Titterton and
Weston, Strapdown Inertial Navigation Technology (2nd ed., doi:10.1049/PBRA017E), section 12.3. Left out: the slow
oscillation with the earth's turn and that of Foucault, which in the half hour of a track are a part in a hundred.
A heading error matters where the vehicle speeds up or turns: then its acceleration is resolved in turned axes.

The model is linear, so the response to each source of error gives both a draw and the covariance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from app.engine.types import Float64Array

GRAVITY = 9.80665
EARTH_RADIUS_M = 6_371_000.0
DEG_PER_H = np.pi / 180.0 / 3600.0


@dataclass(frozen=True, slots=True)
class InertialErrors:
    """Magnitudes of the errors of an inertial navigation system.

    Attributes
    ----------
    gyro_drift_deg_h : float, deg/h
        Constant drift of each gyro.
    accelerometer_bias : float, m/s^2
        Constant bias of each accelerometer.
    gyro_noise_deg_h : float, deg/h
        White, of each reading, standard deviation.
    accelerometer_noise : float, m/s^2
        White, of each reading, standard deviation.
    velocity : float, m/s
        At the start, each axis.
    tilt, heading : float, rad
        At the start.
    """

    gyro_drift_deg_h: float
    accelerometer_bias: float
    gyro_noise_deg_h: float = 0.0
    accelerometer_noise: float = 0.0
    velocity: float = 0.0
    tilt: float = 0.0
    heading: float = 0.0


@dataclass(frozen=True, slots=True)
class Drift:
    """Errors that have added up along a track.

    Attributes
    ----------
    xy : array, shape (n, 2), m, level frame
        Indicated less true position; zero at the first point.
    heading : array, shape (n,), rad
        Indicated less true heading.
    cov : array, shape (n, 2, 2), m^2
        Covariance of ``xy`` over draws.
    """

    xy: Float64Array
    heading: Float64Array
    cov: Float64Array


def simulate_drift(
    errors: InertialErrors, t: Float64Array, course: Float64Array, speed: Float64Array, rng: np.random.Generator
) -> Drift:
    """Draw the drift of one run: each source takes its magnitude with a random sign, noise is Gaussian.

    Parameters
    ----------
    errors : InertialErrors
    t : array, shape (n,), s
        Evenly spaced; the errors are integrated at these times.
    course : array, shape (n,), rad
        True direction of motion, counter-clockwise from +x.
    speed : array, shape (n,), m/s
    rng : numpy.random.Generator
    """
    dt = float(t[1] - t[0])
    acc, gyro, velocity, tilt = _sources(errors, t, course, speed)
    response = _integrate(acc, gyro, velocity, tilt, dt)
    signs = rng.choice([-1.0, 1.0], size=response.shape[2])
    noise = np.stack([rng.standard_normal((len(t), 2)) for _ in range(2)])
    white = _integrate(
        errors.accelerometer_noise * noise[0][:, :, None],
        errors.gyro_noise_deg_h * DEG_PER_H * noise[1][:, :, None],
        np.zeros((2, 1)), np.zeros((2, 1)), dt,
    )[:, :, 0]  # fmt: skip
    heading = signs[-1] * (errors.heading + errors.gyro_drift_deg_h * DEG_PER_H * (t - t[0]))
    elapsed = t - t[0]
    walked = (errors.accelerometer_noise**2) * dt * elapsed**3 / 3.0
    cov = np.einsum("nik,njk->nij", response, response) + walked[:, None, None] * np.eye(2)
    return Drift(response @ signs + white, heading, cov)


def _sources(
    errors: InertialErrors, t: Float64Array, course: Float64Array, speed: Float64Array
) -> tuple[Float64Array, Float64Array, Float64Array, Float64Array]:
    """One column a source: two accelerometers, two level gyros, velocity and tilt at the start (two each), heading.

    Returns forcing by acceleration and by gyro, shape (n, 2, 9), and initial velocity and tilt, shape (2, 9).
    """
    n = len(t)
    forward = np.stack([np.cos(course), np.sin(course)], axis=1)
    left = np.stack([-forward[:, 1], forward[:, 0]], axis=1)
    acc, gyro = np.zeros((n, 2, 9)), np.zeros((n, 2, 9))
    velocity, tilt = np.zeros((2, 9)), np.zeros((2, 9))
    for column, axis in enumerate((forward, left)):
        acc[:, :, column] = errors.accelerometer_bias * axis
        gyro[:, :, 2 + column] = errors.gyro_drift_deg_h * DEG_PER_H * axis
        velocity[column, 4 + column] = errors.velocity
        tilt[column, 6 + column] = errors.tilt
    motion = speed[:, None] * forward
    change = np.gradient(motion, t, axis=0)
    turned = errors.heading + errors.gyro_drift_deg_h * DEG_PER_H * (t - t[0])
    acc[:, :, 8] = turned[:, None] * np.stack([-change[:, 1], change[:, 0]], axis=1)
    return acc, gyro, velocity, tilt


def _integrate(
    acc: Float64Array, gyro: Float64Array, velocity: Float64Array, tilt: Float64Array, dt: float
) -> Float64Array:
    """Position errors, shape (n, 2, k), zero at the first point; semi-implicit Euler, which keeps the oscillation."""
    n, _, k = acc.shape
    xy = np.zeros((n, 2, k))
    v, psi = velocity.copy(), tilt.copy()
    for i in range(1, n):
        v = v + dt * (acc[i] - GRAVITY * psi)
        psi = psi + dt * (v / EARTH_RADIUS_M + gyro[i])
        xy[i] = xy[i - 1] + dt * v
    return xy
