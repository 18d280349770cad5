"""Particle swarm."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from app.engine.matching.entry import Bound, MatcherEntry
from app.engine.matching.metaheuristic.search import Search
from app.engine.matching.problem import MatchProblem
from app.engine.matching.result import MatchResult
from app.engine.types import Float64Array


@dataclass(frozen=True, slots=True)
class ParticleSwarmParameters:
    """Parameters of :class:`ParticleSwarm`.

    Attributes
    ----------
    budget : int
        Placements that are tried.
    particles : int
        That fly.
    founders : float
        Part of the budget that is drawn on the first reading's contour; the best of these are the particles.
    neighbours : int
        Particles on either side in the ring whose best each one knows of; fewer keep more optima alive.
    own : float
        Pull of a particle's own best.
    shared : float
        Pull of its neighbourhood's best; the sum of both must exceed 4.
    crossover : float
        Part of the particles, the worst, that are replaced in each iteration by blends of others' bests.
    """

    budget: int = 8000
    particles: int = 100
    founders: float = 0.3
    neighbours: int = 4
    own: float = 2.05
    shared: float = 2.05
    crossover: float = 0.1


@dataclass(frozen=True, slots=True)
class ParticleSwarm:
    """Particle swarm over (dx, dy, rotation, scale).

    Velocities shrink by the constriction factor ``2 / |2 - phi - sqrt(phi^2 - 4 phi)|``, ``phi = own + shared`` (Clerc
    and Kennedy 2002, doi:10.1109/4235.985692). Particles begin on the contour of the first reading, and crossover of
    bests keeps them diverse, both as reviewed by Lu et al. 2022, doi:10.19306/j.cnki.2095-8110.2022.02.015, section
    1.2.3.
    """

    parameters: ParticleSwarmParameters = ParticleSwarmParameters()

    def match(self, problem: MatchProblem) -> MatchResult:
        """See :class:`app.engine.matching.Matcher`."""
        p = self.parameters
        search = Search.of(problem, p.budget)
        founders = search.population_on_contour(max(int(p.founders * p.budget), p.particles))
        costs = search.evaluate(founders)
        best = np.argsort(costs, kind="stable")[: p.particles]
        places, own, cost = founders[best], founders[best].copy(), costs[best]
        velocity = 0.05 * search.rng.uniform(-1.0, 1.0, places.shape)
        iterations = 0
        while not search.over:
            leaders = own[_best_neighbours(cost, p.neighbours)]
            velocity = self._velocity(search.rng, velocity, places, own, leaders)
            places = places + velocity
            outside = (places < 0.0) | (places > 1.0)
            velocity[outside] *= -0.5  # what leaves the bounds comes back slower
            places = np.clip(places, 0.0, 1.0)
            self._cross(search.rng, places, velocity, own, cost)
            now = search.evaluate(places)
            better = now < cost
            own[better], cost[better] = places[better], now[better]
            iterations += 1
        return search.answer(iterations=iterations)

    def _velocity(
        self,
        rng: np.random.Generator,
        velocity: Float64Array,
        places: Float64Array,
        own: Float64Array,
        leaders: Float64Array,
    ) -> Float64Array:
        p = self.parameters
        pull = p.own * rng.uniform(size=places.shape) * (own - places)
        pull += p.shared * rng.uniform(size=places.shape) * (leaders - places)
        return constriction(p.own + p.shared) * (velocity + pull)

    def _cross(
        self,
        rng: np.random.Generator,
        places: Float64Array,
        velocity: Float64Array,
        own: Float64Array,
        cost: Float64Array,
    ) -> None:
        """Put the worst particles, at rest, between and about the bests of two others each."""
        count = int(self.parameters.crossover * len(places))
        if count == 0:
            return
        worst = np.argsort(cost, kind="stable")[-count:]
        one, other = rng.integers(0, len(places), (2, count))
        places[worst] = np.clip(own[one] + rng.uniform(-0.5, 1.5, (count, 4)) * (own[other] - own[one]), 0.0, 1.0)
        velocity[worst] = 0.0


def constriction(phi: float) -> float:
    """Factor that keeps velocities from growing; one half below ``phi`` of 4, where the formula has no root."""
    return float(2.0 / abs(2.0 - phi - np.sqrt(phi * phi - 4.0 * phi))) if phi > 4.0 else 0.5


def _best_neighbours(cost: Float64Array, neighbours: int) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    """Index of the best particle of each ring neighbourhood, shape (particles,)."""
    around = (np.arange(len(cost))[:, None] + np.arange(-neighbours, neighbours + 1)) % len(cost)
    leaders: np.ndarray[tuple[int], np.dtype[np.int64]] = around[np.arange(len(cost)), np.argmin(cost[around], axis=1)]
    return leaders


ENTRY = MatcherEntry(
    name="particle_swarm",
    summary="Particle swarm over shift, turn and stretch: constriction, start on the first contour, crossover",
    reference="Lu et al. 2022, doi:10.19306/j.cnki.2095-8110.2022.02.015, section 1.2.3; doi:10.1109/4235.985692",
    parameters=ParticleSwarmParameters,
    create=ParticleSwarm,
    bounds={
        "budget": Bound(10, 1_000_000),
        "particles": Bound(2, 10_000),
        "founders": Bound(0.0, 1.0),
        "neighbours": Bound(1, 100),
        "own": Bound(0.0, 5.0),
        "shared": Bound(0.0, 5.0),
        "crossover": Bound(0.0, 0.9),
    },
)
