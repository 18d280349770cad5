from __future__ import annotations

import itertools

import pytest

from app.engine.localization.choice import POLICY, Scale, Situation, choose
from app.engine.localization.registry import METHODS
from app.engine.types import FeatureSet

SITUATIONS = [
    Situation(*values)
    for values in itertools.product(Scale, FeatureSet, (False, True), (False, True), (False, True), (1, 3))
]


@pytest.mark.parametrize("situation", SITUATIONS)
def test_what_is_chosen_can_serve(situation: Situation) -> None:
    """No caller of ``auto`` gets a method that lacks something there."""
    method = METHODS[choose(situation).method]
    assert situation.features in method.features
    assert situation.levels == 1 or method.kind == "tracker"
    assert situation.prior or not method.needs_prior
    assert situation.has_routes or not method.needs_routes


def test_every_row_is_reached_and_says_why() -> None:
    chosen = {choose(situation).why for situation in SITUATIONS}
    assert chosen == {row.why for row in POLICY}
    assert max(map(len, chosen)) <= 256  # what a session can store
