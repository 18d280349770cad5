"""Simulated wheels, pauses, magnets and changes of carrying, made of simulated walks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from app.engine.types import Float64Array, ImuSamples, SpeedReadings
from tests.support.walks import CADENCE_HZ, Field, SimulatedWalk, walk_through

DT = 0.02


def drive_through(
    corners: Float64Array, field: Field, rng: np.random.Generator, *, speed_m_s: float = 1.0, readings_hz: float = 10.0
) -> tuple[SimulatedWalk, SpeedReadings]:
    """A robot along straight legs: no gait in its accelerometer, and what its wheels report."""
    walk = walk_through(corners, field, rng, stride_m=speed_m_s / CADENCE_HZ)
    s = walk.samples
    acc = np.array([0.0, 0.0, 9.81]) + 0.3 * rng.standard_normal(s.acc.shape)
    t = np.arange(s.t[0], s.t[-1], 1.0 / readings_hz)
    return replace(walk, samples=replace(s, acc=acc)), SpeedReadings(t, np.full(t.shape, speed_m_s))


def held(samples: ImuSamples, rotation: Rotation) -> ImuSamples:
    """The motion with the device turned by ``rotation`` (n of them), body of then to body of before."""
    back = rotation.inv()
    relative = np.zeros((len(samples), 3))
    relative[1:] = (back[:-1] * rotation[1:]).as_rotvec() / np.diff(samples.t)[:, None]
    return ImuSamples(samples.t, back.apply(samples.mag), back.apply(samples.acc), back.apply(samples.gyro) + relative)


def turning(t: Float64Array, at: float, angles_deg: tuple[float, float, float], *, seconds: float = 0.8) -> Rotation:
    """Rotations at ``t`` (n,) that go from none to Euler angles (about x, y, z of the body) within some seconds."""
    share = np.clip((t - at) / seconds, 0.0, 1.0)
    eased = share**2 * (3.0 - 2.0 * share)
    return Rotation.from_rotvec(eased[:, None] * Rotation.from_euler("xyz", angles_deg, degrees=True).as_rotvec())


def standing(seconds: float, rng: np.random.Generator, *, at: ImuSamples, gyro_offset: Float64Array) -> ImuSamples:
    """A device at rest after the last of these samples: sensor noise, and a gyroscope that is off."""
    n = int(seconds / DT)
    t = at.t[-1] + DT * np.arange(1, n + 1)
    mag = at.mag[-1] + 0.3 * rng.standard_normal((n, 3))
    acc = np.array([0.0, 0.0, 9.81]) + 0.05 * rng.standard_normal((n, 3))
    return ImuSamples(t, mag, acc, gyro_offset + 0.003 * rng.standard_normal((n, 3)))


def shifted(samples: ImuSamples, t0: float) -> ImuSamples:
    """The same samples, beginning at ``t0``."""
    return replace(samples, t=samples.t - samples.t[0] + t0)


def chained(*pieces: ImuSamples) -> ImuSamples:
    """One recording of several."""
    return ImuSamples(
        *(np.concatenate([getattr(piece, name) for piece in pieces]) for name in ("t", "mag", "acc", "gyro"))
    )


def dipole(moment: Float64Array, from_source: Float64Array) -> Float64Array:
    """Field (n, 3), uT, of a magnetic moment (3,), A m^2, at places (n, 3), m, seen from it."""
    r = np.linalg.norm(from_source, axis=1, keepdims=True)
    along = from_source / r
    field: Float64Array = 0.1 * (3.0 * along * (along @ moment)[:, None] - moment) / r**3
    return field
