"""When nothing of a source is used, though single cells of it may agree: verdicts on sources as a whole."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from app.engine.mapping.crowd.agreement import Comparison
from app.engine.mapping.crowd.passes import Passes
from app.engine.mapping.crowd.policy import Reason, TrustPolicy
from app.engine.mapping.model import MapModel
from app.engine.types import BoolArray, Float64Array

_CAPPED = 1.5
"""Times the misfit that disagrees: more than this one cell adds nothing to the doubt of its source."""


@dataclass(frozen=True, slots=True, eq=False)
class Heard:
    """Passes as they compare with those of others.

    Attributes
    ----------
    passes : Passes
    comparison : Comparison
    judged : array, shape (p,), bool
        Those of sessions that could be compared.
    agreed : array, shape (p,), bool
    new : array, shape (p,), bool
        Those that tell of a change.
    """

    passes: Passes
    comparison: Comparison
    judged: BoolArray
    agreed: BoolArray
    new: BoolArray

    def per_source(self, what: BoolArray | Float64Array) -> Float64Array:
        """Sum over the passes of each source, shape (s,)."""
        return np.bincount(self.passes.source, what).astype(np.float64)


def contradicted(heard: Heard, model: MapModel, policy: TrustPolicy) -> dict[int, Reason]:
    """Sources that others contradict, over all or by one offset: index -> why, the plainest reason first."""
    count = heard.per_source(heard.judged)
    enough = count >= policy.least_cells
    mean, variance = bias(heard, policy)
    allowed = (policy.bias_ut / model.level.sd) ** 2 + variance[:, None]
    biased = enough & ((mean**2 / allowed).max(axis=1) > policy.bias_sds**2)
    refuted = enough & (heard.per_source(heard.judged & heard.agreed) < policy.contradicted * count)
    return {
        **dict.fromkeys(np.flatnonzero(enough & _misplaced(heard, policy)).tolist(), Reason.MISPLACED),
        **dict.fromkeys(np.flatnonzero(biased).tolist(), Reason.BIASED),
        **dict.fromkeys(np.flatnonzero(refuted).tolist(), Reason.CONTRADICTED),
    }


def bias(heard: Heard, policy: TrustPolicy) -> tuple[Float64Array, Float64Array]:
    """Mean residual of each source, shape (s, channels), and its variance (s,), units of the field's variance.

    A change is no offset, nor is what may become one: outliers count for less.
    """
    comparison = heard.comparison
    robust = np.minimum(1.0, policy.disagree / np.maximum(comparison.misfit, 1e-9))
    precision = np.where(heard.judged & ~heard.new, robust / comparison.variance, 0.0)
    total = np.maximum(heard.per_source(precision), 1e-9)
    columns = [heard.per_source(precision * column) / total for column in comparison.residual.T]
    return np.stack(columns, axis=1), policy.alike_cells / total


def _misplaced(heard: Heard, policy: TrustPolicy) -> BoolArray:
    """Sources that agree nowhere well, though hardly anywhere badly, shape (s,): so does a walk told of another place.

    A misfit is chi-square over its degrees of freedom, one per channel: mean 1, variance 2 per degree.
    """
    counted = heard.judged & ~heard.new
    count = np.maximum(heard.per_source(counted), 1.0)
    capped = np.minimum(heard.comparison.misfit, _CAPPED * policy.disagree)  # a change ahead: no doubt about the rest
    mean = heard.per_source(np.where(counted, capped, 0.0)) / count
    sd = np.sqrt(2.0 / heard.passes.value.shape[1] * policy.alike_cells / count)
    return np.asarray(mean > policy.misfit + policy.bias_sds * sd)
