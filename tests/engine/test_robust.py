"""Surveys with walks that are wrong: the map must not bend."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from app.engine.mapping.offsets import WalkOffsets, estimate_offsets, rotate_horizontal
from app.engine.mapping.robust import LEAST_WEIGHT, estimate_robustly
from app.engine.mapping.samples import PlacedSamples
from tests.support.walks import Field


@pytest.fixture
def placed() -> list[PlacedSamples]:
    """Ten walks round one loop, both ways, half a metre apart, each with a hard iron of its own."""
    rng, field = np.random.default_rng(2), Field.random(np.random.default_rng(9), sd=8.0)
    angle = np.linspace(0.0, 2.0 * np.pi, 160, endpoint=False)
    walks = []
    for i in range(10):
        a = angle if i % 2 else angle[::-1]
        xy = np.stack([12.0 * np.cos(a), 8.0 * np.sin(a)], axis=1) + rng.uniform(-0.4, 0.4, 2)
        heading = np.arctan2(*np.gradient(xy, axis=0).T[::-1])
        mag = rotate_horizontal(field.at(xy), -heading) + rng.normal(0.0, 3.0, 3) + 0.4 * rng.standard_normal((160, 3))
        walks.append(PlacedSamples(f"w{i}", np.arange(160.0), xy, heading, mag))
    return walks


def _misplaced(walk: PlacedSamples) -> PlacedSamples:
    """As after a wrong waypoint: half of the loop where the other half is."""
    return replace(walk, xy=np.roll(walk.xy, 40, axis=0), heading=np.roll(walk.heading, 40))


def _beside_steel(walk: PlacedSamples) -> PlacedSamples:
    """Pushed on a trolley whose field swings by tens of microtesla."""
    swing = 25.0 * np.sin(0.3 * walk.t)
    return replace(walk, mag=walk.mag + swing[:, None] * np.array([1.0, -0.5, 0.8]))


def _bend(one: WalkOffsets, other: WalkOffsets, walks: list[PlacedSamples]) -> float:
    """Root mean square by which the corrected fields of the good walks differ, uT."""
    change = [one.field(i, walk) - other.field(i, walk) for i, walk in enumerate(walks)]
    return float(np.sqrt((np.concatenate(change) ** 2).mean()))


@pytest.mark.parametrize("spoil", [_misplaced, _beside_steel])
def test_a_wrong_walk_loses_its_weight_and_bends_nothing(placed: list[PlacedSamples], spoil) -> None:
    good = placed[1:]
    truth = estimate_offsets(good)
    offsets, weight = estimate_robustly([*good, spoil(placed[0])])
    weights = weight.reshape(10, 160).mean(axis=1)
    assert weights[-1] < 0.1
    assert (weights[:-1] == 1.0).all()
    assert _bend(truth, offsets, good) < 0.5
    plain = estimate_offsets([*good, spoil(placed[0])])
    assert _bend(truth, offsets, good) < 0.6 * _bend(truth, plain, good)


def test_good_walks_keep_all_weight(placed: list[PlacedSamples]) -> None:
    offsets, weight = estimate_robustly(placed)
    assert (weight == 1.0).all()
    np.testing.assert_allclose(offsets.hard_iron, estimate_offsets(placed).hard_iron)


def test_a_walk_that_meets_no_other_is_not_judged(placed: list[PlacedSamples]) -> None:
    far = replace(_beside_steel(placed[0]), xy=placed[0].xy + 500.0)
    _, weight = estimate_robustly([*placed[1:], far])
    assert (weight > LEAST_WEIGHT).all()
    assert (weight[-160:] == 1.0).all()
