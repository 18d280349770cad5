"""Maps in features that need less."""

from __future__ import annotations

import gc
import weakref
from dataclasses import replace

import numpy as np

from app.engine.matching import features_of
from app.engine.types import FeatureSet
from tests.support.fields import field_map


def test_reduced_maps_are_those_of_the_vectors_and_are_remembered() -> None:
    grid_map = field_map(np.random.default_rng(1), shape=(6, 7))
    x, y, z = grid_map.mean
    h, v = features_of(grid_map, FeatureSet.HV)[0]
    np.testing.assert_allclose(h, np.hypot(x, y), rtol=1e-6)
    np.testing.assert_array_equal(v, z)
    total, sd = features_of(grid_map, FeatureSet.TOTAL)
    np.testing.assert_allclose(total[0], np.sqrt(x**2 + y**2 + z**2), rtol=1e-6)
    np.testing.assert_allclose(sd, 0.3, rtol=1e-6)
    assert features_of(grid_map, FeatureSet.TOTAL)[0] is total
    assert features_of(grid_map, FeatureSet.VECTOR)[0] is grid_map.mean
    other = replace(grid_map, mean=2.0 * grid_map.mean)
    assert features_of(other, FeatureSet.TOTAL)[0] is not total


def test_a_map_is_not_kept_alive() -> None:
    grid_map = field_map(np.random.default_rng(1), shape=(6, 7))
    features_of(grid_map, FeatureSet.HV)
    gone = weakref.ref(grid_map)
    del grid_map
    gc.collect()
    assert gone() is None
