"""Soft iron: what a device's own steel does to the field's shape, told by a walk whose place is known.

The measured field is ``(I + S) m + b``: ``m`` the true field in the levelled device frame (forward, left, up), ``S``
the soft iron, ``b`` the hard iron (the sensor model of Vasconcelos et al. 2011, doi:10.1109/TAES.2011.5751259). Where
the place is known, the map predicts ``m``, and ``S``, ``b`` and the error of the heading follow from a recursive linear
regression. They are conditioned on the track (one estimate a session, at the particles' mean), not sampled and not kept
per particle: a few percent of soft iron move a place by decimetres, so that particles would hardly differ.

What can be told apart:

* An antisymmetric ``S`` is a turn, of the heading or of how the phone is held. It is the heading's: ``S`` is symmetric,
  and the heading a nuisance that wanders.
* Of a phone held level on a straight line all of ``S`` looks like hard iron. Turning tells: the horizontal elements go
  with twice the angle, forward-up and left-up make the vertical field turn with the walker.
* Up-up is hard iron as long as the vertical field is one and the same; what the building changes of it tells a little.

What is not excited stays at its prior: no soft iron, give or take a few percent.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from app.engine.types import SOFT_IRON_UNKNOWN, DeviceCalibration, Float64Array, SixFloats

_IRON, _OFFSET, _HEADING = slice(0, 6), slice(6, 9), 9
_HORIZONTAL = [0, 1, 3]
_OBSERVABLE = [0, 1, 3, 4, 5]
_STATES = 10
_IDENTITY = np.eye(_STATES)


@dataclass(frozen=True, slots=True)
class SoftIronLaw:
    """What is thought of soft iron before and between steps, and when it counts.

    Attributes
    ----------
    offset_sd : float, uT
        Of the hard iron, before the first step.
    heading_sd : float, rad
        Of the tracker's heading at the first step.
    heading_walk : float, rad per root of a metre
        By which the gyroscope's heading wanders.
    offset_walk : float, uT per root of a metre
    outlier : float
        Squared innovation over its variance, three channels, from which on a reading counts for less.
    excited : float
        Share of the prior's standard deviation below which the horizontal elements are known.
    significant : float
        Standard deviations by which an element must differ from none for readings to be corrected.
    settled : float
        By less the correction in use is not changed.
    """

    offset_sd: float = 5.5
    heading_sd: float = 0.2
    heading_walk: float = 0.0075
    offset_walk: float = 0.09
    outlier: float = 11.3
    excited: float = 0.5
    significant: float = 3.0
    settled: float = 0.015


_LAW = SoftIronLaw()


@dataclass(frozen=True, slots=True)
class Reading:
    """The field at a step, beside what the map says of it.

    Attributes
    ----------
    measured : array, shape (3,), uT
        Forward, left, up of the levelled device, as it came.
    predicted : array, shape (3,), uT, level frame
    variance : array, shape (3,), uT^2
        Of the difference: map, noise about it and the spread of the place. Of neighbours that err alike each has to
        count for its share only.
    azimuth : float, rad
        Heading of the device, free azimuth.
    heading : float, rad, level frame
        The same as the tracker has it; only the first one counts.
    way : float, m
        Walked since the reading before.
    """

    measured: Float64Array
    predicted: Float64Array
    variance: Float64Array
    azimuth: float
    heading: float
    way: float


def _nothing() -> Float64Array:
    return np.zeros(6)


@dataclass(frozen=True, slots=True, eq=False)
class SoftIron:
    """Estimate of one session, and the correction that it has led to.

    Attributes
    ----------
    mean : array, shape (10,)
        Elements of ``S`` (forward-forward, left-left, up-up, forward-left, forward-up, left-up), hard iron (uT), error
        of the heading (rad, 0 after each step).
    cov : array, shape (10, 10)
    turned : float or None, rad
        Level frame's heading less free azimuth; None before the first step and after a gap.
    applied : array, shape (6,)
        Elements that readings are corrected by; all 0: none is.
    """

    mean: Float64Array
    cov: Float64Array
    turned: float | None = None
    applied: Float64Array = field(default_factory=_nothing)

    @classmethod
    def start(cls, known: DeviceCalibration | None, law: SoftIronLaw = _LAW) -> SoftIron:
        """From what is known of the device, the correction included that it calls for."""
        mean, sd = np.zeros(_STATES), np.full(_STATES, law.offset_sd)
        mean[_IRON] = 0.0 if known is None else known.soft_iron
        sd[_IRON] = SOFT_IRON_UNKNOWN if known is None else known.soft_iron_sd
        if known is not None:
            mean[_OFFSET], sd[_OFFSET] = known.offset, np.minimum(known.offset_sd, law.offset_sd)
        sd[_HEADING] = law.heading_sd
        return cls(mean, np.diag(sd**2)).renewed(law)

    @property
    def elements(self) -> SixFloats:
        """``S``: forward-forward, left-left, up-up, forward-left, forward-up, left-up."""
        return _six(self.mean[_IRON])

    @property
    def sd(self) -> SixFloats:
        """Their standard deviations."""
        return _six(np.sqrt(np.diag(self.cov)[_IRON]))

    def is_excited(self, law: SoftIronLaw = _LAW) -> bool:
        """Whether the walker has turned enough for the horizontal elements to be known."""
        variances = self.cov.diagonal()[_HORIZONTAL]
        return bool(variances.max() < (law.excited * SOFT_IRON_UNKNOWN) ** 2)

    def is_significant(self, law: SoftIronLaw = _LAW) -> bool:
        """Whether there is soft iron beyond doubt: excited, and an element that is not nought."""
        if not self.is_excited(law):
            return False
        squared = self.mean[_OBSERVABLE] ** 2 / self.cov.diagonal()[_OBSERVABLE]
        return bool(squared.max() > law.significant**2)

    def observe(self, reading: Reading, law: SoftIronLaw = _LAW) -> SoftIron:
        """After one more reading: an extended Kalman filter's, whose only bend is the heading."""
        turned = reading.heading - reading.azimuth if self.turned is None else self.turned
        angle = reading.azimuth + turned
        c, s = math.cos(angle), math.sin(angle)
        x, y, up = reading.predicted.tolist()
        m = np.array([c * x + s * y, c * y - s * x, up])
        distortion = np.eye(3) + matrix(self.mean[_IRON])
        jacobian = _jacobian(m, distortion)
        expected = distortion @ m + self.mean[_OFFSET]
        wandered = [reading.way * law.offset_walk**2] * 3 + [reading.way * law.heading_walk**2]
        cov = self.cov + np.diag([0.0] * 6 + wandered)
        mean, cov = _update(self.mean, cov, jacobian, reading.measured - expected, reading.variance, law)
        turned, mean[_HEADING] = turned + float(mean[_HEADING]), 0.0
        return replace(self, mean=mean, cov=cov, turned=turned)

    def renewed(self, law: SoftIronLaw = _LAW) -> SoftIron:
        """With the correction that the estimate calls for: none, the one in use if it is about right, or a new one."""
        wanted = self.mean[_IRON] if self.is_significant(law) else _nothing()
        if not wanted.any() and not self.applied.any():
            return self
        if self.applied.any() and self.is_excited(law) and np.abs(wanted - self.applied).max() < law.settled:
            return self
        return replace(self, applied=wanted.copy())

    def shifted(self, shift: float) -> SoftIron:
        """After the field has jumped by so much, uT, and stayed so: the hard iron is open by it."""
        return replace(self, cov=self.cov + np.diag([0.0] * 6 + [shift**2] * 3 + [0.0]))

    def after_gap(self, law: SoftIronLaw = _LAW) -> SoftIron:
        """After a time nobody watched: the gyroscope did not either."""
        cov = self.cov.copy()
        cov[_HEADING, :] = cov[:, _HEADING] = 0.0
        cov[_HEADING, _HEADING] = law.heading_sd**2
        return replace(self, cov=cov, turned=None)

    def correct(self, mag: Float64Array) -> Float64Array:
        """Readings (..., 3), uT, forward, left, up, with the soft iron in use taken off; the same ones without any."""
        return _without(mag, self.applied)


def matrix(elements: Float64Array) -> Float64Array:
    """Symmetric 3x3 matrix from its elements, in the order of :attr:`DeviceCalibration.soft_iron`."""
    ff, ll, uu, fl, fu, lu = elements
    return np.array([[ff, fl, fu], [fl, ll, lu], [fu, lu, uu]])


def without_soft_iron(mag: Float64Array, known: DeviceCalibration | None) -> Float64Array:
    """Readings (..., 3), uT, forward, left, up, less the soft iron known of the device, if that is beyond doubt."""
    return SoftIron.start(known).correct(mag)


def _without(mag: Float64Array, elements: Float64Array) -> Float64Array:
    """``(I + S)^-1 mag`` of readings (..., 3)."""
    if not elements.any():
        return mag
    corrected: Float64Array = mag @ np.linalg.inv(np.eye(3) + matrix(elements))  # symmetric: no transpose
    return corrected


def _six(values: Float64Array) -> SixFloats:
    ff, ll, uu, fl, fu, lu = values.tolist()
    return ff, ll, uu, fl, fu, lu


def _jacobian(m: Float64Array, distortion: Float64Array) -> Float64Array:
    """Derivative of the reading ``distortion m + offset`` by the states, shape (3, 10)."""
    forward, left, up = m.tolist()
    turned = (distortion[:, 0] * left - distortion[:, 1] * forward).tolist()
    return np.array(
        [
            [forward, 0.0, 0.0, left, up, 0.0, 1.0, 0.0, 0.0, turned[0]],
            [0.0, left, 0.0, forward, 0.0, up, 0.0, 1.0, 0.0, turned[1]],
            [0.0, 0.0, up, 0.0, forward, left, 0.0, 0.0, 1.0, turned[2]],
        ]
    )


def _update(
    mean: Float64Array,
    cov: Float64Array,
    jacobian: Float64Array,
    innovation: Float64Array,
    variance: Float64Array,
    law: SoftIronLaw,
) -> tuple[Float64Array, Float64Array]:
    """Kalman update in Joseph's form; a reading that is an outlier is taken for as noisy as it looks."""
    crossed = jacobian @ cov
    spread = crossed @ jacobian.T
    precision = np.linalg.inv(spread + np.diag(variance))
    nis = float(innovation @ precision @ innovation)
    if nis > law.outlier:
        variance = variance * (nis / law.outlier) ** 2
        precision = np.linalg.inv(spread + np.diag(variance))
    gain = crossed.T @ precision
    keep = _IDENTITY - gain @ jacobian
    return mean + gain @ innovation, keep @ cov @ keep.T + (gain * variance) @ gain.T
