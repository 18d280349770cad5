"""Subsequence DTW: the profile against all stretches of all routes at once, whatever their lengths."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from app.engine.matching.conclude import conclude
from app.engine.matching.dtw.bands import full_band
from app.engine.matching.dtw.library import Library, library_of, routes_features, routes_spacing
from app.engine.matching.dtw.placing import Warping, begins_in, ends_in, place, sd_along_route, settle, warp
from app.engine.matching.dtw.search import Deadline, Steps, best_places, subsequence_costs
from app.engine.matching.dtw.signals import (
    Centre,
    Resample,
    Treatment,
    as_it_is,
    difference,
    high_pass,
    query_of,
    untreated,
)
from app.engine.matching.dtw.windows import TOO_SHORT
from app.engine.matching.entry import Bound, MatcherEntry
from app.engine.matching.problem import MatchProblem
from app.engine.matching.result import MatchResult
from app.engine.types import Float64Array

POINTS = 1500
"""Most points of a query; a longer track is compared at wider spacing."""


@dataclass(frozen=True, slots=True)
class SubsequenceParameters:
    """Parameters of subsequence DTW.

    Attributes
    ----------
    spacing_m : float, m
        Distance at which profile and routes are compared; 0 takes the routes' own.
    resample : Resample
        Whether the profile's points are equally far apart in way or in time.
    steps : Steps
        Which steps a path may take; ``skipping`` allows speeds off by up to a factor of two.
    centre : Centre
        How the sensor's offset is taken out; ``mean`` compares profile and routes less their local means.
    centre_m : float, m
        Way over which the local mean is taken.
    places : int
        Places that are looked at closely.
    separation_m : float, m
        Along a route, between two places.
    aside_sd_m : float, m
        How far beside the route's line people walk, one sigma.
    """

    spacing_m: float = 0.0
    resample: Resample = Resample.DISTANCE
    steps: Steps = Steps.SKIPPING
    centre: Centre = Centre.MEAN
    centre_m: float = 12.0
    places: int = 20
    separation_m: float = 5.0
    aside_sd_m: float = 0.7


def treatment_of(centre: Centre, centre_m: float, spacing_m: float) -> Treatment:
    """What is compared where stretches have no length of their own to take a mean over."""
    if centre is Centre.MEAN:
        return high_pass(max(round(centre_m / spacing_m), 2))
    return difference if centre is Centre.DIFFERENCE else as_it_is


def warp_to(query: Float64Array, library: Library, end: int, steps: Steps) -> Warping | None:
    """Path onto the best stretch that ends at a point of a library."""
    first = max(int(library.begin[end]), end - 2 * len(query))
    stretch = library.values[first : end + 1]
    return warp(query, stretch, first, full_band(len(query), len(stretch)), steps, open_ends=(True, False))


class SubsequenceDtwMatcher:
    """DTW with open ends over all routes, both ways, all channels together."""

    def __init__(self, parameters: SubsequenceParameters) -> None:
        self.parameters = parameters

    def match(self, problem: MatchProblem) -> MatchResult:
        """See :meth:`app.engine.matching.Matcher.match`."""
        p, deadline = self.parameters, Deadline(problem.deadline_s)
        spacing_m = routes_spacing(problem, p.spacing_m, POINTS)
        features = routes_features(problem)
        treatment = treatment_of(p.centre, p.centre_m, spacing_m)
        query = query_of(problem, features, spacing_m, treatment, resample=p.resample)
        library = library_of(problem.routes, features, spacing_m, treatment)
        raw = query_of(problem, features, spacing_m, untreated(treatment), resample=p.resample)
        plain = library_of(problem.routes, features, spacing_m, untreated(treatment))
        if query is None or library is None or raw is None or plain is None:
            return conclude(problem, [], evaluated=0, note=TOO_SHORT)
        costs = subsequence_costs(query.values, library, p.steps, deadline=deadline)
        begins = begins_in(problem.region, library)
        total = np.where(ends_in(begins, len(query)), costs.total, np.inf)
        candidates = []
        for end in best_places(total, library, places=p.places, separation_m=p.separation_m):
            warping = warp_to(query.values, library, end, p.steps)
            if warping is None:
                continue
            centred = p.centre is not Centre.NONE
            warping = settle(raw.values, plain, warping, p.steps, separation_m=p.separation_m, centred=centred)
            if begins[warping.pairs[0, 1]]:
                last = int(warping.pairs[-1, 1]) - warping.first
                sd = sd_along_route(problem, plain, warping.ends, last, warping)
                candidates.append(place(problem, raw, plain, warping, sd, p.aside_sd_m))
        return conclude(problem, candidates, evaluated=costs.evaluated, converged=costs.complete)


BOUNDS = {
    "spacing_m": Bound(0.0, 10.0),
    "centre_m": Bound(1.0, 1000.0),
    "places": Bound(1, 200),
    "separation_m": Bound(0.5, 100.0),
    "aside_sd_m": Bound(0.05, 10.0),
}
ENTRY = MatcherEntry(
    name="subsequence_dtw",
    summary="Warping of the whole profile onto any stretch of the routes: finds place and speed at once.",
    reference="Sakurai et al. 2007, doi:10.1109/ICDE.2007.368963; Zhang 2021 (Hangzhou Dianzi University), 3.1.2",
    parameters=SubsequenceParameters,
    create=SubsequenceDtwMatcher,
    bounds=BOUNDS,
    needs_routes=True,
    dimensions=1,
    scales=("indoor", "route"),
)
