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

    def kernel_parameters(self) -> Float64Array:
        """Parameters as the kernel wants them."""
        coarse, fine = np.sqrt(3.0) / self.length_m, np.sqrt(3.0) / self.fine_length_m
        return np.array([coarse, self.error, 1.0 / self.error_length_m, self.white, self.fine, fine])


@dataclass(frozen=True, slots=True)
class FieldSamples:
    """Placed, corrected samples: ``xy`` (n, 2) m, ``walk`` (n,) owner index, ``values`` (n, channels) uT."""

    xy: Float64Array
    walk: IntArray
    values: Float64Array

    def __len__(self) -> int:
        return int(self.xy.shape[0])

    def subset(self, keep: BoolArray | IntArray) -> FieldSamples:
        """Rows of a mask or index array."""
        return FieldSamples(self.xy[keep], self.walk[keep], self.values[keep])


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


def field_samples(evidence: Evidence, model: MapModel) -> FieldSamples:  # noqa: ARG001
    """Rows in use as samples for kriging."""
    used = evidence.subset(evidence.weight > 0.0)
    return FieldSamples(used.xy.astype(np.float64), used.source.astype(np.int64), used.values.astype(np.float64))
