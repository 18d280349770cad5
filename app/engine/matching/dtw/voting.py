"""Voting of three axes: the place of a magnetometer without odometry, where two of its three axes agree on it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from app.engine.errors import InputError
from app.engine.matching.conclude import conclude
from app.engine.matching.dtw.library import Library, routes_features, routes_spacing
from app.engine.matching.dtw.placing import begins_in, ends_in
from app.engine.matching.dtw.search import Costs, Deadline, Steps, best_places, subsequence_costs
from app.engine.matching.dtw.signals import Centre, Query, Resample
from app.engine.matching.dtw.subsequence import BOUNDS, POINTS, compared, placed
from app.engine.matching.dtw.windows import TOO_SHORT
from app.engine.matching.entry import Bound, MatcherEntry
from app.engine.matching.problem import MatchProblem
from app.engine.matching.result import MatchResult
from app.engine.types import BoolArray, FeatureSet, Float64Array

_AXES = 3
_VOTES = 2
DISAGREE = "no two axes agree on a place"


@dataclass(frozen=True, slots=True)
class VotingParameters:
    """Parameters of three-axis voting.

    Attributes
    ----------
    speed_mps : float, m/s
        By which time is turned into way; the warping makes up for a factor of two either way.
    spacing_m : float, m
        Distance at which profile and routes are compared; 0 takes the routes' own.
    centre : Centre
        How the sensor's offset is taken out; ``mean`` compares profile and routes less their local means.
    centre_m : float, m
        Way over which the local mean is taken.
    agree_m : float, m
        Along a route, between the places of two axes that are taken for one.
    places : int
        Best places of each axis that take part in the vote.
    aside_sd_m : float, m
        How far beside the route's line people walk, one sigma.
    """

    speed_mps: float = 1.2
    spacing_m: float = 0.0
    centre: Centre = Centre.MEAN
    centre_m: float = 12.0
    agree_m: float = 3.0
    places: int = 5
    aside_sd_m: float = 0.7


class VotingDtwMatcher:
    """Each axis of the device's frame alone against the routes; a place counts with two of the three votes."""

    def __init__(self, parameters: VotingParameters) -> None:
        self.parameters = parameters

    def match(self, problem: MatchProblem) -> MatchResult:
        """See :meth:`app.engine.matching.Matcher.match`."""
        p, deadline = self.parameters, Deadline(problem.deadline_s)
        spacing_m = routes_spacing(problem, p.spacing_m, POINTS)
        features = routes_features(problem)
        if features is not FeatureSet.VECTOR:
            raise InputError(
                "features", f"three axes vote, and {features} has not got them: give vectors and their map"
            )
        sequences = compared(
            problem, features, spacing_m, p.centre, p.centre_m, resample=Resample.TIME, speed_mps=p.speed_mps
        )
        if sequences is None:
            return conclude(problem, [], evaluated=0, note=TOO_SHORT)
        query, library = sequences.query, sequences.library
        costs = [_of_axis(query, library, k, deadline) for k in range(_AXES)]
        begins = begins_in(problem.region, library)
        reach = max(round(p.agree_m / spacing_m), 1)
        found = [
            placed(
                problem, sequences, end, Steps.SKIPPING, uneven=0.0, reach_m=p.agree_m,
                centred=p.centre is not Centre.NONE, begins=begins, aside_sd_m=p.aside_sd_m,
            )
            for end in _elected(costs, library, ends_in(begins, len(sequences.raw)), p.places, reach)
        ]  # fmt: skip
        candidates = [one for one in found if one is not None]
        return conclude(
            problem,
            candidates,
            evaluated=sum(one.evaluated for one in costs),
            converged=all(one.complete for one in costs),
            note="" if candidates else DISAGREE,
        )


def _of_axis(query: Query, library: Library, axis: int, deadline: Deadline) -> Costs:
    """Costs of one axis alone."""
    alone = Library(
        values=library.values[:, [axis]],
        x=library.x,
        y=library.y,
        route=library.route,
        begin=library.begin,
        spacing_m=library.spacing_m,
        sd=library.sd,
    )
    return subsequence_costs(query.values[:, [axis]], alone, Steps.SKIPPING, uneven=0.0, deadline=deadline)


def _elected(costs: list[Costs], library: Library, allowed: BoolArray, places: int, reach: int) -> list[int]:
    """Ends that two axes vote for, each the cheapest of all axes' costs together within ``reach``."""
    together = sum((one.total for one in costs), np.zeros(len(library)))
    separation_m = reach * library.spacing_m
    ballots = [
        best_places(np.where(allowed, one.total, np.inf), library, places=places, separation_m=separation_m)
        for one in costs
    ]
    elected: list[int] = []
    for axis, ballot in enumerate(ballots):
        for end in ballot:
            near = slice(max(end - reach, int(library.begin[end])), end + reach + 1)
            votes = 1 + sum(
                any(abs(other - end) <= reach and library.route[other] == library.route[end] for other in list_)
                for k, list_ in enumerate(ballots)
                if k != axis
            )
            if votes >= _VOTES:
                elected.append(near.start + int(np.argmin(_on_route(together, library, near, end))))
    return sorted(set(elected))


def _on_route(costs: Float64Array, library: Library, near: slice, end: int) -> Float64Array:
    """Costs of a stretch, infinite where it belongs to another route than point ``end``."""
    return np.where(library.route[near] == library.route[end], costs[near], np.inf)


ENTRY = MatcherEntry(
    name="voting_dtw",
    summary="A magnetometer alone: each of its axes is warped onto the routes by time, and two of three must agree.",
    reference="Bao, Shang and Shi 2019 (Chinese Journal of Sensors and Actuators, 10), part 1",
    parameters=VotingParameters,
    create=VotingDtwMatcher,
    bounds={name: BOUNDS[name] for name in ("spacing_m", "centre_m", "places", "aside_sd_m")}
    | {"speed_mps": Bound(0.1, 50.0), "agree_m": Bound(0.2, 50.0)},
    features=(FeatureSet.VECTOR,),
    needs_odometry=False,
    needs_routes=True,
    dimensions=1,
    scales=("indoor", "route"),
)
