"""Genetic algorithm."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from app.engine.matching.entry import Bound, MatcherEntry
from app.engine.matching.metaheuristic.search import Search
from app.engine.matching.problem import MatchProblem
from app.engine.matching.result import MatchResult
from app.engine.types import Float64Array


@dataclass(frozen=True, slots=True)
class GeneticParameters:
    """Parameters of :class:`Genetic`.

    Attributes
    ----------
    budget : int
        Placements that are tried.
    population : int
        Placements of a generation.
    founders : float
        Part of the budget that is drawn evenly before the first selection.
    tournament : int
        Individuals of which the best becomes a parent.
    crossover : float
        Probability that two parents' genes are blended rather than one parent's taken.
    mutation : float
        Probability that a gene is mutated.
    spread : float
        Standard deviation of a mutation as a part of the bounds, in the first generation.
    shrink : float
        What the spread has become, as a part of the first, in the last generation.
    elite : int
        Best individuals that live on.
    """

    budget: int = 8000
    population: int = 120
    founders: float = 0.3
    tournament: int = 3
    crossover: float = 0.7
    mutation: float = 0.6
    spread: float = 0.08
    shrink: float = 0.02
    elite: int = 6


@dataclass(frozen=True, slots=True)
class Genetic:
    """Genetic algorithm over (dx, dy, rotation, scale).

    Selection by tournament, blend crossover, Gaussian mutation that narrows from generation to generation, elitism. As
    reviewed by Lu et al. 2022, doi:10.19306/j.cnki.2095-8110.2022.02.015, section 1.2.3; the fitness is the mean
    absolute difference of readings and map.
    """

    parameters: GeneticParameters = GeneticParameters()

    def match(self, problem: MatchProblem) -> MatchResult:
        """See :class:`app.engine.matching.Matcher`."""
        p = self.parameters
        search = Search.of(problem, p.budget)
        places = search.population(max(int(p.founders * p.budget), p.population))
        costs = search.evaluate(places)
        best = np.argsort(costs, kind="stable")[: p.population]
        places, costs = places[best], costs[best]
        first, generations = search.evaluated, 0
        while not search.over:
            done = (search.evaluated - first) / max(p.budget - first, 1)
            children = self._children(search, places, costs, p.spread * p.shrink**done)
            added = search.evaluate(children)
            places, costs = self._next(places, costs, children, added)
            generations += 1
        return search.answer(iterations=generations)

    def _children(self, search: Search, places: Float64Array, costs: Float64Array, spread: float) -> Float64Array:
        """As many children as there are parents, shape (population, 4)."""
        p, rng, size = self.parameters, search.rng, len(places)
        fathers, mothers = (_tournament(rng, costs, size, p.tournament) for _ in range(2))
        blend = rng.uniform(-0.25, 1.25, (size, 4))
        mixed = places[fathers] + blend * (places[mothers] - places[fathers])
        children = np.where(rng.uniform(size=(size, 1)) < p.crossover, mixed, places[fathers])
        mutated = rng.uniform(size=(size, 4)) < p.mutation
        children += mutated * spread * rng.standard_normal((size, 4))
        return np.clip(children, 0.0, 1.0)

    def _next(
        self, places: Float64Array, costs: Float64Array, children: Float64Array, added: Float64Array
    ) -> tuple[Float64Array, Float64Array]:
        """The children and the best of their parents, without the worst children."""
        elite = np.argsort(costs, kind="stable")[: self.parameters.elite]
        kept = np.argsort(added, kind="stable")[: max(len(places) - len(elite), 1)]
        return np.concatenate([places[elite], children[kept]]), np.concatenate([costs[elite], added[kept]])


def _tournament(
    rng: np.random.Generator, costs: Float64Array, size: int, rivals: int
) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    """Indices of the winners, shape (size,)."""
    drawn = rng.integers(0, len(costs), (size, rivals))
    winners: np.ndarray[tuple[int], np.dtype[np.int64]] = drawn[np.arange(size), np.argmin(costs[drawn], axis=1)]
    return winners


ENTRY = MatcherEntry(
    name="genetic",
    summary="Genetic algorithm over shift, turn and stretch: tournament, blend crossover, narrowing mutation",
    reference="Lu et al. 2022, doi:10.19306/j.cnki.2095-8110.2022.02.015, section 1.2.3",
    parameters=GeneticParameters,
    create=Genetic,
    bounds={
        "budget": Bound(10, 1_000_000),
        "population": Bound(4, 10_000),
        "founders": Bound(0.0, 1.0),
        "tournament": Bound(1, 50),
        "crossover": Bound(0.0, 1.0),
        "mutation": Bound(0.0, 1.0),
        "spread": Bound(1e-6, 1.0),
        "shrink": Bound(1e-6, 1.0),
        "elite": Bound(0, 100),
    },
)
