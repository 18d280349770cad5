"""How far a contributor is trusted: the share of what he said that others bore out."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from app.engine.mapping.crowd.policy import TrustPolicy
from app.engine.types import Float64Array


def prior_counts(contributor: str, reputation: Mapping[str, float], policy: TrustPolicy) -> tuple[float, float]:
    """Beta parameters before anything is compared: agreeing and disagreeing cells, so to say."""
    known = reputation.get(contributor)
    if known is None:
        return policy.reputation_prior
    share = min(max(known, 0.0), 1.0)
    return policy.reputation_cells * share, policy.reputation_cells * (1.0 - share)


def posterior(
    prior: tuple[Float64Array, Float64Array], agreed: Float64Array, judged: Float64Array, policy: TrustPolicy
) -> Float64Array:
    """Mean of the Beta posterior, capped.

    Parameters
    ----------
    prior : two arrays, shape (w,)
    agreed, judged : arrays, shape (w,)
        Cells that agreed, and cells that could be compared; neighbours err together and count for
        ``1 / alike_cells`` each.
    """
    a = prior[0] + agreed / policy.alike_cells
    b = prior[1] + (judged - agreed) / policy.alike_cells
    return np.minimum(a / np.maximum(a + b, 1e-9), policy.reputation_cap)
