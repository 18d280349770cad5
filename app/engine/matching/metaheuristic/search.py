"""What the population searches share: bounds, budget, the record of all that was tried, and the answer made of it."""

from __future__ import annotations

import time
from dataclasses import dataclass, field

import numpy as np

from app.engine.matching.conclude import conclude
from app.engine.matching.placements import PlacementObjective
from app.engine.matching.problem import MatchProblem
from app.engine.matching.result import MatchResult
from app.engine.matching.starts import SCALE_SD, TURN_SD, distinct, first_contour, uncalibrated
from app.engine.types import Float64Array

_SIGMAS = 3.0
_WIDENING = 3.0
_LEAST_SCALE = 0.3
_APART_CELLS = 4.0


@dataclass(slots=True, eq=False)
class Search:
    """One search: places in the unit cube of (dx, dy, rotation, scale), their costs, and what is left of the budget.

    Attributes
    ----------
    problem : MatchProblem
    objective : PlacementObjective
    low, high : array, shape (4,)
        Bounds: the region's 3 sigma, or the map and the usual errors of a track's shape.
    budget : int
        Placements that may be tried.
    rng : numpy.random.Generator
    began : float, s
        Processor time.
    places, costs : list of arrays
        All that was tried, in order.
    """

    problem: MatchProblem
    objective: PlacementObjective
    low: Float64Array
    high: Float64Array
    budget: int
    rng: np.random.Generator
    began: float
    evaluated: int = 0
    places: list[Float64Array] = field(default_factory=list)
    costs: list[Float64Array] = field(default_factory=list)

    @classmethod
    def of(cls, problem: MatchProblem, budget: int) -> Search:
        """Of a problem, with the generator that its seed gives."""
        low, high = bounds(problem)
        objective = PlacementObjective.of(problem, centred=uncalibrated(problem.profile))
        return cls(problem, objective, low, high, budget, np.random.default_rng(problem.seed), time.thread_time())

    @property
    def over(self) -> bool:
        """Whether the budget is spent or, after the first placements, the deadline has passed."""
        return self.evaluated >= self.budget or (self.evaluated > 0 and self.late)

    @property
    def late(self) -> bool:
        """Whether the deadline has passed."""
        deadline = self.problem.deadline_s
        return deadline is not None and time.thread_time() - self.began > deadline

    def evaluate(self, places: Float64Array) -> Float64Array:
        """Costs of places of shape (p, 4), shape (p,), uT; infinite off the map and once the budget is spent."""
        costs = np.full(len(places), np.inf)
        tried = places[: max(self.budget - self.evaluated, 0)]
        if len(tried):
            costs[: len(tried)] = self.objective.costs(self.low + tried * (self.high - self.low))
            self.evaluated += len(tried)
            self.places.append(tried.copy())
            self.costs.append(costs[: len(tried)].copy())
        return costs

    def population(self, size: int) -> Float64Array:
        """Places drawn evenly from the bounds, shape (size, 4)."""
        return self.rng.uniform(0.0, 1.0, (size, 4))

    def population_on_contour(self, size: int) -> Float64Array:
        """Places whose first point lies on the widened contour of the first reading; evenly drawn if it is nowhere."""
        places = self.population(size)
        points = first_contour(self.problem, _WIDENING, _SIGMAS)
        if len(points):
            shifts = points[self.rng.integers(0, len(points), size)] - self.problem.track.xy[0]
            jitter = self.problem.grid_map.cell_m * self.rng.uniform(-0.5, 0.5, (size, 2))
            places[:, :2] = (shifts + jitter - self.low[:2]) / (self.high[:2] - self.low[:2])
        return np.clip(places, 0.0, 1.0)

    def answer(self, *, iterations: int, note: str = "") -> MatchResult:
        """The distinct optima of all that was tried, judged."""
        places, costs = np.concatenate(self.places), np.concatenate(self.costs)
        placements = self.low + places * (self.high - self.low)
        apart = _APART_CELLS * self.problem.grid_map.cell_m
        kept = distinct(placements, costs, apart, 8, self.problem.track.xy)
        return conclude(
            self.problem,
            [self.objective.candidate(placements[i], float(costs[i])) for i in kept],
            evaluated=self.evaluated,
            iterations=iterations,
            converged=not self.late or self.evaluated >= self.budget,
            note=note if kept else "no placement lies on mapped ground",
        )


def bounds(problem: MatchProblem) -> tuple[Float64Array, Float64Array]:
    """Lowest and highest dx, dy (m), rotation (rad) and scale that are searched, shape (4,) each."""
    region, first = problem.region, problem.track.xy[0]
    turn_sd, scale_sd = (TURN_SD, SCALE_SD) if region is None else (region.heading_sd, region.scale_sd)
    shape = np.array([_SIGMAS * turn_sd, _SIGMAS * scale_sd])
    if region is None:
        x_min, y_min, x_max, y_max = problem.grid_map.extent
        low, high = np.array([x_min, y_min]) - first, np.array([x_max, y_max]) - first
    else:
        half = np.array(region.half_widths(_SIGMAS))
        low, high = np.array([region.x, region.y]) - half - first, np.array([region.x, region.y]) + half - first
    least = max(1.0 - shape[1], _LEAST_SCALE)
    width = np.maximum(high - low, 1e-9)  # a region of no width is searched where it is
    return np.array([*low, -shape[0], least]), np.array([*(low + width), shape[0], 1.0 + shape[1]])
