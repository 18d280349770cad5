"""Levelled samples: tilt from gravity, heading from the gyroscope with a free azimuth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from app.engine.kernels.attitude import level
from app.engine.types import Float64Array, ImuSamples

TILT_GAIN = 0.25
"""1/s: tilt follows the accelerometer within about four seconds, gait averages out."""
_START_S = 0.3


@dataclass(frozen=True, slots=True)
class Attitude:
    """Attitude at ``t``: quaternion of the body in the free-azimuth level frame, and unwrapped heading."""

    t: float
    q: tuple[float, float, float, float]
    heading: float


@dataclass(frozen=True, slots=True)
class LevelledSamples:
    """Samples turned into the walker's own level frame.

    Attributes
    ----------
    t : array, shape (n,), s
    mag : array, shape (n, 3), uT
        Forward, left, up.
    heading : array, shape (n,), rad
        Unwrapped heading of the forward axis, counter-clockwise, zero at the session's start.
    vertical : array, shape (n,), m/s^2
        Specific force along the vertical.
    """

    t: Float64Array
    mag: Float64Array
    heading: Float64Array
    vertical: Float64Array

    def __len__(self) -> int:
        return int(self.t.shape[0])


def initial_attitude(samples: ImuSamples) -> Attitude:
    """Level with the mean accelerometer reading of the first 0.3 s; the forward axis gets heading 0."""
    early = samples.t <= samples.t[0] + _START_S
    up = samples.acc[early].mean(axis=0)
    norm = float(np.linalg.norm(up))
    up = up / norm if norm > 1.0 else np.array([0.0, 0.0, 1.0])
    forward = np.array([0.0, 1.0, 0.0]) - up[1] * up
    if forward @ forward < 0.25:
        forward = -np.array([0.0, 0.0, 1.0]) + up[2] * up
    forward /= np.linalg.norm(forward)
    q = _quaternion(np.stack([forward, np.cross(up, forward), up]))
    return Attitude(float(samples.t[0]), q, 0.0)


def level_samples(samples: ImuSamples, attitude: Attitude | None = None) -> tuple[LevelledSamples, Attitude]:
    """Turn body samples into forward, left, up.

    A complementary filter (Mahony et al., 2008, doi:10.1109/TAC.2008.923738, without its magnetometer term): the
    gyroscope turns, the accelerometer slowly corrects tilt. Heading is integrated only, so its drift is the
    gyroscope's.

    Parameters
    ----------
    samples : ImuSamples
        At least one sample.
    attitude : Attitude or None
        Attitude at the end of the samples before these; None starts anew.
    """
    start = attitude or initial_attitude(samples)
    q = np.array(start.q)
    last = np.array([start.t, start.heading])
    out = np.empty((len(samples), 5))
    t, mag, acc, gyro = (
        np.ascontiguousarray(a, np.float64) for a in (samples.t, samples.mag, samples.acc, samples.gyro)
    )
    level(t, mag, acc, gyro, q, last, TILT_GAIN, out)
    end = Attitude(float(last[0]), (float(q[0]), float(q[1]), float(q[2]), float(q[3])), float(last[1]))
    return LevelledSamples(t, *map(np.ascontiguousarray, (out[:, :3], out[:, 3], out[:, 4]))), end


def _quaternion(c_lb: Float64Array) -> tuple[float, float, float, float]:
    """Scalar-first quaternion of a rotation matrix (body to level)."""
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.from_matrix(c_lb).as_quat()
    return float(w), float(x), float(y), float(z)
