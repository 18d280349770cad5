"""Subsequence DTW: the profile against all stretches of all routes at once, whatever their lengths."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from app.engine.matching.conclude import conclude
from app.engine.matching.dtw.bands import full_band
from app.engine.matching.dtw.library import Library, library_of, routes_features, routes_spacing
from app.engine.matching.dtw.placing import begins_in, ends_in, place, sd_along_route, settle, warp
from app.engine.matching.dtw.search import Deadline, Steps, best_places, subsequence_costs
from app.engine.matching.dtw.signals import (
    Centre,
    Query,
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
from app.engine.matching.result import Candidate, MatchResult
from app.engine.types import BoolArray, FeatureSet

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
    evenness : float
        Cost of a skipping step by which the route does not go on by exactly one point, in variances of a difference.
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
    evenness: float = 1.0
    centre: Centre = Centre.MEAN
    centre_m: float = 12.0
    places: int = 20
    separation_m: float = 5.0
    aside_sd_m: float = 0.7


@dataclass(frozen=True, slots=True)
class Compared:
    """A problem as sequences: what is compared of track and routes, and the readings and the map themselves."""

    query: Query
    library: Library
    raw: Query
    plain: Library


def compared(
    problem: MatchProblem,
    features: FeatureSet,
    spacing_m: float,
    centre: Centre,
    centre_m: float,
    *,
    resample: Resample,
    speed_mps: float | None = None,
) -> Compared | None:
    """Sequences of a problem; None if the track is too short."""
    of_query: Treatment = difference if centre is Centre.DIFFERENCE else as_it_is
    of_routes = of_query
    if centre is Centre.MEAN:
        window = max(round(centre_m / spacing_m), 2)
        of_query, of_routes = high_pass(window, whole=False), high_pass(window, whole=True)
    whole = untreated(of_routes)
    queries = [
        query_of(problem, features, spacing_m, one, resample=resample, speed_mps=speed_mps) for one in (of_query, whole)
    ]
    libraries = [library_of(problem.routes, features, spacing_m, one) for one in (of_routes, whole)]
    if queries[0] is None or queries[1] is None or libraries[0] is None or libraries[1] is None:
        return None
    return Compared(queries[0], libraries[0], queries[1], libraries[1])


def cost_of_uneven(problem: MatchProblem, library: Library, steps: Steps, evenness: float) -> float:
    """Cost of a step off the diagonal, uT^2; classic steps, of which such ones come in pairs, have none."""
    variance = float((problem.profile.noise_sd**2).mean()) + library.sd**2
    return evenness * variance * library.values.shape[1] if steps is Steps.SKIPPING else 0.0


def placed(
    problem: MatchProblem,
    sequences: Compared,
    end: int,
    steps: Steps,
    *,
    uneven: float,
    reach_m: float,
    centred: bool,
    begins: BoolArray,
    aside_sd_m: float,
) -> Candidate | None:
    """The track where its best path to an end puts it; None if there is none, or not from where it may begin.

    Parameters
    ----------
    problem : MatchProblem
    sequences : Compared
    end : int
        Point of the library at which what is compared ends.
    steps : Steps
    uneven : float, uT^2
        Cost of a step off the diagonal.
    reach_m : float, m
        How far the ends may still move.
    centred : bool
        Whether there is an offset to take out.
    begins : array, shape (m,), bool
        Points of the library at which the track may begin.
    aside_sd_m : float, m
        Standard deviation of the last point across the route.
    """
    query, plain = sequences.query.values, sequences.plain
    first = max(int(sequences.library.begin[end]), end - 2 * len(query))
    stretch = sequences.library.values[first : end + 1]
    band = full_band(len(query), len(stretch))
    warping = warp(query, stretch, first, band, steps, open_ends=(True, False), uneven=uneven)
    if warping is None:
        return None
    raw, cut = sequences.raw, sequences.query.cut
    warping = settle(raw.values, cut, plain, warping, steps, separation_m=reach_m, centred=centred, uneven=uneven)
    if not begins[warping.pairs[0, 1]]:
        return None
    last = int(warping.pairs[-1, 1]) - warping.first
    sd = sd_along_route(problem, plain, warping.ends, last, warping)
    return place(problem, raw, plain, warping, sd, aside_sd_m)


class SubsequenceDtwMatcher:
    """DTW with open ends over all routes, both ways, all channels together."""

    def __init__(self, parameters: SubsequenceParameters) -> None:
        self.parameters = parameters

    def match(self, problem: MatchProblem) -> MatchResult:
        """See :meth:`app.engine.matching.Matcher.match`."""
        p, deadline = self.parameters, Deadline(problem.deadline_s)
        spacing_m = routes_spacing(problem, p.spacing_m, POINTS)
        features = routes_features(problem)
        sequences = compared(problem, features, spacing_m, p.centre, p.centre_m, resample=p.resample)
        if sequences is None:
            return conclude(problem, [], evaluated=0, note=TOO_SHORT)
        library = sequences.library
        uneven = cost_of_uneven(problem, library, p.steps, p.evenness)
        costs = subsequence_costs(sequences.query.values, library, p.steps, uneven=uneven, deadline=deadline)
        begins = begins_in(problem.region, library)
        total = np.where(ends_in(begins, len(sequences.raw)), costs.total, np.inf)
        found = [
            placed(
                problem, sequences, end, p.steps, uneven=uneven, reach_m=p.separation_m,
                centred=p.centre is not Centre.NONE, begins=begins, aside_sd_m=p.aside_sd_m,
            )
            for end in best_places(total, library, places=p.places, separation_m=p.separation_m)
        ]  # fmt: skip
        candidates = [one for one in found if one is not None]
        return conclude(problem, candidates, evaluated=costs.evaluated, converged=costs.complete)


BOUNDS = {
    "spacing_m": Bound(0.0, 10.0),
    "centre_m": Bound(1.0, 1000.0),
    "evenness": Bound(0.0, 100.0),
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
