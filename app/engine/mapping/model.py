"""The statistical model of a level's map: covariance, level, and the samples it is about."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from app.engine.types import BoolArray, Evidence, Float64Array, IntArray


@dataclass(frozen=True, slots=True)
class Covariance:
    """Covariance of field samples, in units of the field's variance (the sill).

    The field is the sum of a coarse part (the building, far steel) and a fine one (reinforcement, shop fronts).
    A sample is field + the walk's own error + white noise. The walk's error (wrong position times gradient, height and
    carrying, passing metal) is correlated along the walk; without it a walk's many samples would
    count as independent witnesses and the map would claim a standard deviation it does not have.

    Attributes
    ----------
    length_m : float
        Matern 3/2 length of the field's coarse part.
    fine : float
        Variance of its fine part, 0 to 1.
    fine_length_m : float
        Matern 3/2 length of that.
    error : float
        Variance of the walk's own error.
    error_length_m : float
        Its exponential length.
    white : float
        Variance of white noise.
    curl_free : bool
        The first two channels are the components of a gradient and are kriged together (no current flows through
        the air, so the horizontal field has no curl in the plane); their sill must be the same. Else every channel
        stands for itself.
    stretch : float
        The field's lengths across ``stretch_angle`` over those along it are ``1 / stretch``; their product is kept.
    stretch_angle : float, rad
        Direction of the longer axis, counter-clockwise from +x.
    """

    length_m: float = 5.0
    error: float = 0.4
    error_length_m: float = 2.0
    white: float = 0.1
    fine: float = 0.5
    fine_length_m: float = 1.5
    curl_free: bool = False
    stretch: float = 1.0
    stretch_angle: float = 0.0

    @property
    def noise(self) -> float:
        """Variance of one sample about the field."""
        return self.error + self.white

    @property
    def squared_gradient(self) -> float:
        """Expected squared gradient of the field, both axes together, units of the sill per square metre."""
        # a Matern 3/2 process of length L has slope variance 3 / L^2 per axis
        coarse, fine = 3.0 / self.length_m**2, 3.0 / self.fine_length_m**2
        return 2.0 * ((1.0 - self.fine) * coarse + self.fine * fine)

    def position_variance(self, spread: Float64Array) -> Float64Array:
        """What a position that is uncertain by ``spread`` (n,) m per axis adds to a sample's variance, (n,).

        Gradient times displacement for small ones; it levels off at the sill (McHutchon and Rasmussen 2011, Gaussian
        process training with input noise, section 3, has the first part).
        """
        grown: Float64Array = spread**2 * self.squared_gradient
        return grown / (1.0 + grown)

    @property
    def reach_m(self) -> float:
        """Samples farther away than this say hardly anything: their correlation is below 0.08."""
        return 2.5 * self.length_m * float(np.sqrt(max(self.stretch, 1.0 / self.stretch)))

    def to_isotropic(self) -> Float64Array:
        """Symmetric matrix (2, 2) of determinant one that takes a lag to the plane where the field is isotropic."""
        c, s = np.cos(self.stretch_angle), np.sin(self.stretch_angle)
        turn = np.array([[c, s], [-s, c]])
        shape: Float64Array = turn.T @ np.diag([self.stretch**-0.5, self.stretch**0.5]) @ turn
        return shape

    @property
    def gradient_sills(self) -> Float64Array:
        """Variances of a gradient's x and y component where the isotropic field has one, shape (2,)."""
        shape = self.to_isotropic()
        return np.diag(shape @ shape).copy()

    def kernel_parameters(self) -> Float64Array:
        """Parameters in the order of :mod:`app.engine.kernels.kriging`, shape (17,)."""
        rates = np.sqrt(3.0) / np.array([self.length_m, self.fine_length_m])
        shape = self.to_isotropic()
        triangle = np.triu_indices(2)
        # one, largest exponent, a 64th, coefficients of Pade's fraction of the exponential
        constants = [1.0, 640.0, 1.0 / 64.0, 0.1, 0.5, 1.0 / 120.0]
        return np.concatenate(
            [
                [1.0 - self.fine, self.fine],
                rates,
                [1.0 / self.error_length_m],
                shape[triangle],
                (shape @ shape)[triangle],
                constants,
            ]
        )


@dataclass(frozen=True, slots=True, eq=False)
class FieldSamples:
    """Placed, corrected samples of the field.

    Attributes
    ----------
    xy : array, shape (n, 2), m
    walk : array, shape (n,)
        Index of the walk that a sample belongs to: samples of one walk share its error.
    values : array, shape (n, channels), uT
    extra : array, shape (n,), units of the sill, or None
        Variance of the walk's error beyond ``Covariance.error``: what an uncertain position adds. None: nothing.
    weight : array, shape (n,), above 0 to 1, or None
        All noise of a sample is taken ``1 / weight`` times as large. None: one each.
    """

    xy: Float64Array
    walk: IntArray
    values: Float64Array
    extra: Float64Array | None = None
    weight: Float64Array | None = None

    def __len__(self) -> int:
        return int(self.xy.shape[0])

    def subset(self, keep: BoolArray | IntArray) -> FieldSamples:
        """Rows of a mask or index array."""
        extra, weight = (None if a is None else a[keep] for a in (self.extra, self.weight))
        return FieldSamples(self.xy[keep], self.walk[keep], self.values[keep], extra, weight)

    def noise(self, covariance: Covariance) -> tuple[Float64Array, Float64Array]:
        """Standard deviation of the walk's error and variance of the white noise of each sample, units of the sill."""
        n = len(self)
        extra = np.zeros(n) if self.extra is None else self.extra
        weight = np.ones(n) if self.weight is None else self.weight
        return np.sqrt((covariance.error + extra) / weight), covariance.white / weight


@dataclass(frozen=True, slots=True)
class FieldLevel:
    """Level mean and standard deviation of the field per channel, uT: what is known where nobody walked."""

    mean: Float64Array
    sd: Float64Array


@dataclass(frozen=True, slots=True)
class MapModel:
    """What was fitted to a level when its map was built; updates of the map go on with it."""

    level: FieldLevel
    covariance: Covariance

    def values(self) -> dict[str, Any]:
        """Plain values for JSON."""
        level = {"mean": self.level.mean.tolist(), "sd": self.level.sd.tolist()}
        return {"level": level, "covariance": asdict(self.covariance)}

    @classmethod
    def from_values(cls, values: Mapping[str, Any]) -> MapModel:
        """Inverse of :meth:`values`, also after JSON."""
        level = values["level"]
        return cls(FieldLevel(np.array(level["mean"]), np.array(level["sd"])), Covariance(**values["covariance"]))


def field_samples(evidence: Evidence, model: MapModel) -> FieldSamples:
    """The rows of evidence that are in use, as kriging wants them.

    Parameters
    ----------
    evidence : Evidence
    model : MapModel
        Its covariance says what an uncertain position costs.

    Returns
    -------
    FieldSamples
        In the order of the evidence, without rows of weight 0; ``walk`` is the evidence's ``source``.
    """
    used = np.flatnonzero(evidence.weight > 0)
    spread = evidence.spread[used].astype(np.float64)
    return FieldSamples(
        xy=evidence.xy[used].astype(np.float64),
        walk=evidence.source[used].astype(np.int64),
        values=evidence.values[used].astype(np.float64),
        extra=model.covariance.position_variance(spread),
        weight=evidence.weight[used].astype(np.float64),
    )
