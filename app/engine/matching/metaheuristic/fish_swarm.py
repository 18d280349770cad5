"""Artificial fish swarm."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from app.engine.matching.entry import Bound, MatcherEntry
from app.engine.matching.metaheuristic.search import Search
from app.engine.matching.problem import MatchProblem
from app.engine.matching.result import MatchResult
from app.engine.types import Float64Array

_LEAST_VISUAL = 1e-6
"""A fish that sees less goes nowhere, and the search would not end."""


@dataclass(frozen=True, slots=True)
class FishSwarmParameters:
    """Parameters of :class:`FishSwarm`.

    Attributes
    ----------
    budget : int
        Placements that are tried.
    fish : int
        That swim.
    founders : float
        Part of the budget that is drawn evenly; the best of these are the fish.
    visual : float
        How far a fish sees, as a part of the bounds, in the first iteration.
    shrink : float
        What that has become, as a part of the first, in the last iteration.
    step : float
        Longest step, as a part of what a fish sees.
    tries : int
        Places that a fish looks at for prey before it swims at random.
    crowding : float
        Part of all fish above which a place is crowded.
    """

    budget: int = 8000
    fish: int = 60
    founders: float = 0.3
    visual: float = 0.15
    shrink: float = 0.02
    step: float = 0.7
    tries: int = 3
    crowding: float = 0.4


_LEAST_VISUAL = 1e-6
"""A fish that sees less goes nowhere, and the search would not end."""


@dataclass(frozen=True, slots=True)
class FishSwarm:
    """Artificial fish swarm over (dx, dy, rotation, scale).

    Each fish takes the best of *swarm* (towards the middle of those it sees, unless crowded), *follow* (towards the
    best of those) and *prey* (towards a better place among some that it looks at); if none is better, it swims at
    *random*. What a fish sees narrows over the search. As reviewed by Lu et al. 2022,
    doi:10.19306/j.cnki.2095-8110.2022.02.015, section 1.2.3.
    """

    parameters: FishSwarmParameters = FishSwarmParameters()

    def match(self, problem: MatchProblem) -> MatchResult:
        """See :class:`app.engine.matching.Matcher`."""
        p = self.parameters
        search = Search.of(problem, p.budget)
        founders = search.population(max(int(p.founders * p.budget), p.fish))
        costs = search.evaluate(founders)
        best = np.argsort(costs, kind="stable")[: p.fish]
        places, costs = founders[best], costs[best]
        first, iterations = search.evaluated, 0
        while not search.over:
            done = (search.evaluated - first) / max(p.budget - first, 1)
            places, costs = self._swim(search, places, costs, max(p.visual * p.shrink**done, _LEAST_VISUAL))
            iterations += 1
        return search.answer(iterations=iterations)

    def _swim(
        self, search: Search, places: Float64Array, costs: Float64Array, visual: float
    ) -> tuple[Float64Array, Float64Array]:
        """All fish once; shapes (fish, 4) and (fish,)."""
        p, rng, n = self.parameters, search.rng, len(places)
        sees = np.abs(places[:, None] - places).max(axis=2) <= visual
        middle = (sees[:, :, None] * places).sum(axis=1) / sees.sum(axis=1)[:, None]
        leader = places[np.argmin(np.where(sees, costs, np.inf), axis=1)]
        uncrowded = (sees.sum(axis=1) <= p.crowding * n)[:, None]
        reach = p.step * visual
        length = rng.uniform(0.3, 1.0, (2, n, 1))
        swarm = np.where(uncrowded, places + _limited(middle - places, reach) * length[0], places)
        follow = places + _limited(leader - places, reach) * length[1]
        prey = places + visual * rng.uniform(-1.0, 1.0, (p.tries, n, 4))
        moves = np.clip(np.concatenate([swarm[None], follow[None], prey]), 0.0, 1.0)
        # who goes nowhere is not tried again
        still = np.abs(moves - places).max(axis=2) <= 0.0
        found = np.full(moves.shape[:2], np.inf)
        found[~still] = search.evaluate(moves[~still])
        chosen = np.argmin(found, axis=0)
        least = found[chosen, np.arange(n)]
        better = least < costs
        roams = ~better & (costs > np.median(costs))  # the better half waits; the others swim on at random
        after = np.where(better[:, None], moves[chosen, np.arange(n)], places)
        after[roams] = moves[2, roams]
        return after, np.where(better, least, np.where(roams, found[2], costs))


def _limited(steps: Float64Array, reach: float) -> Float64Array:
    """Steps of shape (n, 4), none of whose parts is longer than ``reach``."""
    longest = np.abs(steps).max(axis=1, keepdims=True)
    limited: Float64Array = steps * np.minimum(1.0, reach / np.maximum(longest, 1e-12))
    return limited


ENTRY = MatcherEntry(
    name="fish_swarm",
    summary="Artificial fish swarm over shift, turn and stretch: prey, swarm, follow, random",
    reference="Lu et al. 2022, doi:10.19306/j.cnki.2095-8110.2022.02.015, section 1.2.3",
    parameters=FishSwarmParameters,
    create=FishSwarm,
    bounds={
        "budget": Bound(10, 1_000_000),
        "fish": Bound(2, 500),
        "founders": Bound(0.0, 1.0),
        "visual": Bound(1e-4, 1.0),
        "shrink": Bound(1e-6, 1.0),
        "step": Bound(0.01, 1.0),
        "tries": Bound(1, 50),
        "crowding": Bound(0.0, 1.0),
    },
)
