"""Levelled samples: tilt from gravity, heading from the gyroscope with a free azimuth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from app.engine.kernels.attitude import level
from app.engine.types import BoolArray, Float64Array, ImuSamples

TILT_GAIN = 0.25
"""1/s: tilt follows the accelerometer within about four seconds, gait averages out."""
_START_S = 0.3
_REST_MEAN_S = 1.0
_REST_GYRO = 0.02
"""rad/s, scatter of the rate up to which a device lies still; a hand trembles with three times as much."""
_REST_RATE = 0.02
"""rad/s: no gyroscope of a phone is off by more; a mean rate beyond it is a turn."""
_REST_FORCE = 0.25
"""m/s^2, scatter of the specific force."""
_REST_S = 1.5
_LEARN_S = 2.0
_PARAMETERS = np.array([TILT_GAIN, _REST_MEAN_S, _REST_GYRO**2, _REST_RATE, _REST_FORCE**2, _REST_S, _LEARN_S])
_AWAKE = (0.01, 1.0)
"""Mean squares of rate and force that a session begins with: some seconds of stillness bring them down."""


@dataclass(frozen=True, slots=True)
class Attitude:
    """Attitude at ``t``.

    Attributes
    ----------
    t : float, s
    q : tuple of four floats
        Quaternion of the body in the free-azimuth level frame, scalar first.
    heading : float, rad
        Unwrapped.
    rest : tuple of twelve floats
        The gyroscope's offset (rad/s) and what tells rest; see :mod:`app.engine.kernels.attitude`.
    """

    t: float
    q: tuple[float, float, float, float]
    heading: float
    rest: tuple[float, ...]


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
    up : array, shape (n, 3)
        Unit vector of the vertical in the body: how the device is held.
    """

    t: Float64Array
    mag: Float64Array
    heading: Float64Array
    vertical: Float64Array
    up: Float64Array

    def __len__(self) -> int:
        return int(self.t.shape[0])

    def since(self, t: float) -> LevelledSamples:
        """Those from ``t`` on."""
        kept = self.t >= t
        return LevelledSamples(self.t[kept], self.mag[kept], self.heading[kept], self.vertical[kept], self.up[kept])

    def then(self, later: LevelledSamples) -> LevelledSamples:
        """These and later ones."""
        return LevelledSamples(
            np.concatenate([self.t, later.t]),
            np.concatenate([self.mag, later.mag]),
            np.concatenate([self.heading, later.heading]),
            np.concatenate([self.vertical, later.vertical]),
            np.concatenate([self.up, later.up]),
        )


def initial_attitude(samples: ImuSamples) -> Attitude:
    """Level with the mean accelerometer reading of the first 0.3 s; the forward axis gets heading 0."""
    early = samples.t <= samples.t[0] + _START_S
    up = samples.acc[early].mean(axis=0)
    norm = float(np.linalg.norm(up))
    up = up / norm if norm > 1.0 else np.array([0.0, 0.0, 1.0])
    forward = np.array([0.0, 1.0, 0.0]) - up[1] * up
    if forward @ forward < 0.25:
        forward = (-1.0 if up[1] > 0.0 else 1.0) * (np.array([0.0, 0.0, 1.0]) - up[2] * up)
    forward /= np.linalg.norm(forward)
    q = _quaternion(np.stack([forward, np.cross(up, forward), up]))
    gyro, acc = samples.gyro[early].mean(axis=0).tolist(), samples.acc[early].mean(axis=0).tolist()
    return Attitude(float(samples.t[0]), q, 0.0, (0.0, 0.0, 0.0, *gyro, _AWAKE[0], *acc, _AWAKE[1], 0.0))


def level_samples(
    samples: ImuSamples, attitude: Attitude | None = None, *, moving: BoolArray | None = None
) -> tuple[LevelledSamples, Attitude]:
    """Turn body samples into forward, left, up.

    A complementary filter (Mahony et al., 2008, doi:10.1109/TAC.2008.923738, without its magnetometer term): the
    gyroscope turns, the accelerometer slowly corrects tilt. Heading is integrated only, so its drift is the
    gyroscope's. A device that lies still for some seconds shows the gyroscope's offset, which is taken off from there
    on: the heading stays through the longest pause on a table or of a robot.

    Parameters
    ----------
    samples : ImuSamples
        At least one sample.
    attitude : Attitude or None
        Attitude at the end of the samples before these; None starts anew.
    moving : array, shape (n,), bool, or None
        True where the device is known to move, however smoothly: a steady bend of a robot's way is no rest.
    """
    start = attitude or initial_attitude(samples)
    q, last, rest = np.array(start.q), np.array([start.t, start.heading]), np.array(start.rest)
    out = np.empty((len(samples), 8))
    t, mag, acc, gyro = (
        np.ascontiguousarray(a, np.float64) for a in (samples.t, samples.mag, samples.acc, samples.gyro)
    )
    known = np.zeros(len(samples), dtype=np.bool_) if moving is None else np.ascontiguousarray(moving)
    level(t, mag, acc, gyro, known, q, last, rest, _PARAMETERS, out)
    w, x, y, z = q.tolist()
    end = Attitude(float(last[0]), (w, x, y, z), float(last[1]), tuple(rest.tolist()))
    return LevelledSamples(t, *map(np.ascontiguousarray, (out[:, :3], out[:, 3], out[:, 4], out[:, 5:]))), end


def _quaternion(c_lb: Float64Array) -> tuple[float, float, float, float]:
    """Scalar-first quaternion of a rotation matrix (body to level)."""
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.from_matrix(c_lb).as_quat()
    return float(w), float(x), float(y), float(z)
