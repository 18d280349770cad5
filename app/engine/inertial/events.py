"""Steps and pieces of way: what a session's motion and field are told in."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from app.engine.types import BoolArray, Float64Array


@dataclass(frozen=True, slots=True)
class StepEvents:
    """Steps, or pieces of way of something on wheels, oldest first.

    Attributes
    ----------
    t : array, shape (k,), s
    swing : array, shape (k,), m/s^2
        Vertical swing (see :class:`app.engine.inertial.Steps`); 0 on wheels.
    motion_heading : array, shape (k,), rad
        Direction of motion but for the carrying angle, free azimuth: the mean heading of the device during the step,
        less what changes of carrying turned it by; opposite on wheels that roll backwards.
    heading : array, shape (k,), rad
        Heading of the device at ``t``.
    mag : array, shape (k, 3), uT
        Field at ``t``: forward, left, up.
    stride : array, shape (k,), m
        Length.
    measured : array, shape (k,), bool
        Whether ``stride`` was measured by wheels, not modelled.
    disturbed : array, shape (k,), bool
        The field cannot be the building's (see :mod:`app.engine.inertial.disturbance`).
    shift : array, shape (k,), uT
        At the first step after a disturbance: what it left behind. Else 0.
    carrying : array, shape (k,), bool
        From here on the device is held another way (see :mod:`app.engine.inertial.carrying`).
    """

    t: Float64Array
    swing: Float64Array
    motion_heading: Float64Array
    heading: Float64Array
    mag: Float64Array
    stride: Float64Array
    measured: BoolArray
    disturbed: BoolArray
    shift: Float64Array
    carrying: BoolArray

    def __len__(self) -> int:
        return int(self.t.shape[0])


FIELDS = tuple(field.name for field in fields(StepEvents))


@dataclass(frozen=True, slots=True)
class Moments:
    """Steps or pieces of way before heading and field are read.

    Attributes
    ----------
    t, swing, stride, measured : arrays, shape (k,)
        As in :class:`StepEvents`.
    course : array, shape (k,), rad
        Direction of motion, free azimuth; NaN where the device's heading is all that tells.
    """

    t: Float64Array
    swing: Float64Array
    stride: Float64Array
    measured: BoolArray
    course: Float64Array

    def __len__(self) -> int:
        return int(self.t.shape[0])

    def merged(self, other: Moments) -> Moments:
        """Both, in time order."""
        if len(self) == 0 or len(other) == 0:
            return other if len(self) == 0 else self
        order = np.argsort(np.concatenate([self.t, other.t]), kind="stable")
        return Moments(
            np.concatenate([self.t, other.t])[order],
            np.concatenate([self.swing, other.swing])[order],
            np.concatenate([self.stride, other.stride])[order],
            np.concatenate([self.measured, other.measured])[order],
            np.concatenate([self.course, other.course])[order],
        )
