"""Evidence as samples to krige from."""

from __future__ import annotations

import numpy as np
import pytest

from app.engine.mapping import Covariance, FieldLevel, MapModel, field_samples
from app.engine.types import Evidence, EvidenceSource, FeatureSet, SourceKind

MODEL = MapModel(FieldLevel(np.zeros(3), np.ones(3)), Covariance())


def _evidence(spread: float, weight: float, *, name: str = "a", n: int = 4) -> Evidence:
    source = EvidenceSource(name, SourceKind.SESSION)
    xy = np.arange(2.0 * n).reshape(n, 2)
    part = Evidence.of(FeatureSet.VECTOR, source, xy, np.ones((n, 3)), spread)
    part.weight[:] = weight
    return part


def test_rows_without_weight_are_left_out() -> None:
    evidence = Evidence.joined([_evidence(0.0, 1.0), _evidence(0.5, 0.0, name="b"), _evidence(0.5, 0.5, name="c")])
    samples = field_samples(evidence, MODEL)
    assert samples.walk.tolist() == [0] * 4 + [2] * 4
    np.testing.assert_array_equal(samples.xy[:4], samples.xy[4:])
    error, white = samples.noise(MODEL.covariance)
    # half the weight is twice the noise, and an uncertain position adds to the walk's error
    np.testing.assert_allclose(error[:4] ** 2, MODEL.covariance.error)
    np.testing.assert_allclose(white[4:], 2.0 * MODEL.covariance.white)
    assert (error[4:] ** 2 > 2.0 * MODEL.covariance.error).all()


@pytest.mark.parametrize("spread", [0.05, 0.2])
def test_a_small_uncertainty_of_position_costs_gradient_times_displacement(spread: float) -> None:
    covariance = Covariance(length_m=6.0, fine=0.3, fine_length_m=2.0)
    lag = 1e-4
    # E[(f(x + d) - f(x))^2] = 2 (1 - C(d)) for a displacement along an axis; both axes add up
    correlation = sum(
        share * (1 + np.sqrt(3) * lag / length) * np.exp(-np.sqrt(3) * lag / length)
        for share, length in ((0.7, 6.0), (0.3, 2.0))
    )
    slope = 2.0 * 2.0 * (1.0 - correlation) / lag**2
    found = covariance.position_variance(np.array([spread]))[0]
    assert found == pytest.approx(slope * spread**2, rel=1.1 * slope * spread**2 + 1e-3)


def test_a_lost_position_costs_the_sill_and_not_more() -> None:
    costs = Covariance().position_variance(np.array([0.0, 1.0, 100.0]))
    assert costs[0] == 0.0
    assert 0.0 < costs[1] < costs[2] <= 1.0
    assert costs[2] > 0.99
