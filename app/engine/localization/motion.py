"""One step of a session's motion taken by particles: what its flags mean for the filter."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from app.engine.filtering import Advance, Cloud, FilterGrid, ParticleNoise, advance_cloud
from app.engine.inertial import StepEvents
from app.engine.localization.initial import InitialSpread
from app.engine.types import FeatureSet, Float64Array

CARRY_SD = 0.5
"""rad: how much less is known of the angle between device and motion after it changed hands."""
_MAX_CARRY = 1.2
"""rad, beyond which the kernel's small-angle turn by the carrying angle is none."""
SHIFT_UT = 20.0
"""Walking through a building shifts the field by less within the few steps of a disturbance."""
UNHEARD = 1e4
"""Times the noise of the field at which a reading tells nothing."""
WHEEL_SCALE = 0.15
"""Scale error of wheels over that of a stride (13 %)."""
_WHEEL_STRIDE = 0.03
_WHEEL_POSITION_M = 0.1


def take_step(
    cloud: Cloud,
    grid: FilterGrid,
    noise: ParticleNoise,
    spread: InitialSpread,
    events: StepEvents,
    i: int,
    heading: float,
    rng: np.random.Generator,
) -> Advance:
    """Move particles by step ``i`` and weigh them by its field.

    * A *disturbed* step moves only. Its likelihood is 1, and the next reading is compared as a first one, since the
      residual it would be whitened with is the disturbance. Where it left the field shifted, the offset is open by as
      much: a magnet came to stay.
    * With a *change of carrying* the carrying angle is open again, and so is the offset: it belongs to the body of the
      device, which was turned. What the device's heading turned by is in ``motion_heading`` already.
    * *Measured* pieces of way (wheels) have a fraction of a stride's noise. The stride scale of a particle stands for
      that of its wheels, drawn towards 1.

    Parameters
    ----------
    cloud : Cloud
        Consumed: its arrays are overwritten.
    heading : float, rad
        Heading of the device at the step before, free azimuth.
    """
    disturbed, measured = bool(events.disturbed[i]), bool(events.measured[i])
    if events.carrying[i]:
        cloud = loosen(cloud, spread, rng)
    if events.shift[i] > SHIFT_UT:
        cloud.p[12:14] = np.maximum(cloud.p[12:14], events.shift[i] ** 2)
    if measured:
        noise = replace(
            noise, stride=_WHEEL_STRIDE, position=_WHEEL_POSITION_M, scale_walk=WHEEL_SCALE * noise.scale_walk
        )
        cloud.p[4] = 1.0 + WHEEL_SCALE * (cloud.p[4] - 1.0)
    moved = advance_cloud(
        cloud,
        grid,
        replace(noise, field=UNHEARD * noise.field) if disturbed else noise,
        turn_mid=float(events.motion_heading[i]) - heading,
        turn=float(events.heading[i]) - heading,
        stride=float(events.stride[i]),
        z=channels(events.mag[i], grid.features),
        rng=rng,
    )
    if measured:
        for particles in {id(c): c for c in (moved.cloud, moved.weighted)}.values():
            particles.p[4] = 1.0 + (particles.p[4] - 1.0) / WHEEL_SCALE
    if not disturbed:
        return moved
    return replace(moved, cloud=replace(moved.cloud, moved=False), estimate=replace(moved.estimate, likelihood=1.0))


def loosen(cloud: Cloud, spread: InitialSpread, rng: np.random.Generator) -> Cloud:
    """The same places, with carrying angle and offset as open as a change of carrying leaves them."""
    p = cloud.p
    carry = p[5] + CARRY_SD * rng.standard_normal(cloud.n)
    p[5] = np.clip(carry, -_MAX_CARRY, _MAX_CARRY)
    p[6:9] = 0.0
    p[12] = spread.offset_horizontal**2
    p[13] = spread.offset_vertical**2
    return Cloud(p, moved=False)


def channels(mag: Float64Array, features: FeatureSet) -> Float64Array:
    """Forward, left, up (3,) as the kernel's channels of a feature set."""
    if features is FeatureSet.VECTOR:
        return mag
    if features is FeatureSet.HV:
        return np.array([np.hypot(mag[0], mag[1]), 0.0, mag[2]])
    return np.array([0.0, 0.0, np.linalg.norm(mag)])
