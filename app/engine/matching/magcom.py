"""MAGCOM: the track is laid on the map at every place where it may be, and the best agreement wins.

Zhang 2021 (2.3), Lu et al. 2022, doi:10.19306/j.cnki.2095-8110.2022.02.015 (1.2.1). As there: the region follows from
the indicated position's covariance, candidates are the track shifted by whole cells, with rotation and stretch where
wanted. What differs: a first search on a coarser map, the best places brought between the cells by a quadratic, ground
without a survey counts neither for nor against, and what may be claimed is judged by the likelihood of all places that
came near (:func:`conclude`).
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from app.engine.matching.conclude import conclude
from app.engine.matching.contour_search import Box, MagcomParameters, centres, first_search, search_box, thinned
from app.engine.matching.criteria import Criterion
from app.engine.matching.criterion_cost import CriterionCost
from app.engine.matching.entry import Bound, MatcherEntry
from app.engine.matching.peaks import descend
from app.engine.matching.problem import MatchProblem, Profile, common_features
from app.engine.matching.result import Candidate, MatchResult
from app.engine.types import Float64Array

__all__ = ["ENTRY", "Magcom", "MagcomParameters"]

_DESCENT = 5
"""Iterations from a place of the first search to the bottom of the cost."""
_DRAWN = (Criterion.COR, Criterion.PROD)
"""Drawn to strong fields: they find neighbourhoods; where in one is settled by the squared difference."""


@dataclass(frozen=True, slots=True)
class Magcom:
    """Contour matching over shifts, with rotation and scale where wanted.

    A placement that is turned or stretched is so about the track's first point.
    """

    parameters: MagcomParameters

    def match(self, problem: MatchProblem) -> MatchResult:
        """Locate the track.

        Raises
        ------
        InputError
            Rotations and scales are more than can be tried.
        """
        p, until = self.parameters, _deadline(problem)
        features = common_features(p.features, problem.profile.features, problem.grid_map.features)
        profile = problem.profile.as_features(features)
        box = search_box(problem, p)
        if np.any(box.low > box.high):
            return conclude(problem, [], evaluated=0, note="the search region lies off the map")
        found = first_search(problem, profile, box, p, until)
        if not len(found.placements):
            return conclude(
                problem, [], evaluated=found.evaluated, converged=found.complete, note="nowhere enough mapped ground"
            )
        candidates, evaluated, complete = _follow_up(problem, profile, box, p, found.placements, until)
        return conclude(
            problem,
            candidates,
            evaluated=found.evaluated + evaluated,
            converged=found.complete and complete,
            note=_second(candidates),
        )


def _deadline(problem: MatchProblem) -> float:
    return np.inf if problem.deadline_s is None else time.thread_time() + problem.deadline_s


def _second(candidates: list[Candidate]) -> str:
    """What the second place of the search costs, in words."""
    if len(candidates) < 2:
        return ""
    first, second = sorted(one.cost for one in candidates)[:2]
    return f"cost {first:.4g}, of the next place {second:.4g}"


def _follow_up(
    problem: MatchProblem, profile: Profile, box: Box, p: MagcomParameters, placements: Float64Array, until: float
) -> tuple[list[Candidate], int, bool]:
    """Candidates of the first search's places: the best of them brought to the bottom of the cost."""
    xy, cell, centre = problem.track.xy, problem.grid_map.cell_m, centres(profile, p)
    arm = xy[0] - xy.mean(axis=0)
    pivot = _about_middle(placements, arm)
    low, high = box.bounds
    turned = len(box.rotations) * len(box.scales) > 1
    if turned:  # about its middle, turns and shifts do not make up for one another
        low[:2], high[:2] = -np.inf, np.inf
    pitch = p.coarse * cell
    half = 0.5 * np.array([pitch, pitch, _gap(box.rotations), _gap(box.scales)])
    axes = [np.array([0.0, -1.0, 1.0]) * one if one > 0.0 else np.zeros(1) for one in half]
    grid = np.stack([part.ravel() for part in np.meshgrid(*axes, indexing="ij")], axis=1)
    around = np.clip(pivot[:, None] + grid, low, high)
    rough = CriterionCost.of(
        p.criterion, problem.grid_map, profile, *thinned(xy, profile.values, pitch), centre=centre, mapped=p.mapped
    )
    costs = rough(_about_first(around.reshape(-1, 4), arm)).reshape(around.shape[:2])
    pick = costs.argmin(axis=1)
    best = around[np.arange(len(pick)), pick][np.argsort(costs.min(axis=1), kind="stable")[: p.listed]]
    evaluated, complete = costs.size, time.thread_time() <= until
    settling = Criterion.MSD if p.criterion in _DRAWN else p.criterion
    exact = CriterionCost.of(settling, problem.grid_map, profile, xy, profile.values, centre=centre, mapped=p.mapped)
    extent = max(float(np.sqrt(np.var(xy, axis=0).sum())), cell)
    step = 0.5 * cell * np.array([1.0, 1.0, half[2] > 0.0, half[3] > 0.0]) / np.array([1.0, 1.0, extent, extent])
    best, cost, asked = descend(
        lambda places: exact(_about_first(places, arm)), best, step, low, high, iterations=_DESCENT if complete else 0
    )
    candidates = [
        exact.objective.candidate(placement, float(value))
        for placement, value in zip(_about_first(best, arm), cost, strict=True)
        if np.isfinite(value)
    ]
    return candidates, evaluated + asked, complete


def _gap(tried: Float64Array) -> float:
    return float(tried[1] - tried[0]) if len(tried) > 1 else 0.0


def _about_middle(placements: Float64Array, arm: Float64Array) -> Float64Array:
    """Placements about the first point as placements about the track's middle; ``arm`` leads from there to it."""
    moved = placements.copy()
    moved[:, :2] -= _swing(placements, arm)
    return moved


def _about_first(placements: Float64Array, arm: Float64Array) -> Float64Array:
    """The way back."""
    moved = placements.copy()
    moved[:, :2] += _swing(placements, arm)
    return moved


def _swing(placements: Float64Array, arm: Float64Array) -> Float64Array:
    """Where the first point goes when the track is turned and stretched about its middle, shape (p, 2)."""
    c, s = placements[:, 3] * np.cos(placements[:, 2]), placements[:, 3] * np.sin(placements[:, 2])
    return np.stack([c * arm[0] - s * arm[1], s * arm[0] + c * arm[1]], axis=1) - arm


ENTRY = MatcherEntry(
    name="magcom",
    summary="Contour matching: the track at every place where it may be, the best agreement wins",
    reference="Lu et al. 2022, doi:10.19306/j.cnki.2095-8110.2022.02.015, 1.2.1",
    parameters=MagcomParameters,
    create=Magcom,
    bounds={
        "sigmas": Bound(1.0, 6.0),
        "rotations": Bound(0, 361),
        "scales": Bound(0, 61),
        "coarse": Bound(1, 8),
        "kept": Bound(1, 500),
        "listed": Bound(1, 50),
        "mapped": Bound(0.1, 1.0),
    },
    needs_heading=True,
)
