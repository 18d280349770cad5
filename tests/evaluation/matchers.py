"""Stand-ins of matchers, obviously right and slow: the papers' protocols are tested with these."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from app.engine.errors import InputError
from app.engine.matching import (
    Candidate,
    Evidence,
    LocatedTrack,
    MatcherEntry,
    MatchProblem,
    MatchResult,
    conclude,
    read_map,
)
from app.engine.types import Float64Array, Status


@dataclass(frozen=True)
class NoParameters:
    pass


class Staying:
    """Leaves the track where it is indicated, and claims it."""

    def match(self, problem: MatchProblem) -> MatchResult:
        located = LocatedTrack(problem.track.x, problem.track.y, np.eye(2), 1.0, 0.0, 1.0, 0.0)
        return MatchResult(Status.OK, (located,), Evidence(1, 0.0, 0.0, 1.0, 1.0))


class Refusing:
    def match(self, problem: MatchProblem) -> MatchResult:
        raise InputError("region", "is missing")


class Clueless:
    def match(self, problem: MatchProblem) -> MatchResult:
        return conclude(problem, [], evaluated=0)


class Exhaustive:
    """All shifts by whole cells within the region, by the mean absolute difference."""

    def match(self, problem: MatchProblem) -> MatchResult:
        track, region, cell = problem.track, problem.region, problem.grid_map.cell_m
        assert region is not None
        steps = np.arange(-region.half_widths(2.5)[0], region.half_widths(2.5)[0], cell)
        shifts = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
        x, y = track.x + shifts[:, :1], track.y + shifts[:, 1:]
        read = read_map(problem.grid_map, problem.profile.features, x.ravel(), y.ravel()).mean
        cost = np.abs(read.reshape(*x.shape, -1) - problem.profile.values).mean(axis=(1, 2))
        found = [Candidate(*placed) for placed in zip(x, y, cost.tolist(), strict=True)]
        found.sort(key=lambda one: one.cost)
        return conclude(problem, found[:20], evaluated=len(found))


class Sliding:
    """The track's way laid on each route at each of its points, either way; least squares about the mean."""

    def match(self, problem: MatchProblem) -> MatchResult:
        walked = problem.track.way
        found = []
        for route in [way for one in problem.routes for way in (one, one.reversed())]:
            at = route.spacing_m * np.arange(len(route))
            mean = route.mean if route.features is problem.profile.features else _reduced(route.mean)
            for start in at[at + walked[-1] <= at[-1]][::3]:
                s = start + walked
                read = np.stack([np.interp(s, at, channel) for channel in mean.T], axis=1)
                away = read - problem.profile.values
                cost = float(((away - away.mean(axis=0)) ** 2).mean())
                found.append(Candidate(np.interp(s, at, route.x), np.interp(s, at, route.y), cost))
        found.sort(key=lambda one: one.cost)
        return conclude(problem, found[:5], evaluated=len(found))


def _reduced(mean: Float64Array) -> Float64Array:
    return np.asarray(np.linalg.norm(mean, axis=1)[:, None])


def entry(name: str, matcher: type, *, needs_routes: bool = False, scales: tuple[str, ...] = ("area",)) -> MatcherEntry:
    return MatcherEntry(
        name, "", "", NoParameters, lambda _parameters: matcher(), needs_routes=needs_routes, scales=scales
    )
