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
    """

    length_m: float = 5.0
    error: float = 0.4
    error_length_m: float = 2.0
    white: float = 0.1
    fine: float = 0.5
    fine_length_m: float = 1.5

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

    def kernel_parameters(self) -> Float64Array:
        """Parameters as the kernel wants them."""
        coarse, fine = np.sqrt(3.0) / self.length_m, np.sqrt(3.0) / self.fine_length_m
        return np.array([coarse, self.error, 1.0 / self.error_length_m, self.white, self.fine, fine])


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
