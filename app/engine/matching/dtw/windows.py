"""Sliding windows: the profile against every stretch of the routes that is as long as the profile itself."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from app.engine.matching.conclude import conclude
from app.engine.matching.dtw.bands import Band, full_band, itakura_band, sakoe_chiba_band
from app.engine.matching.dtw.library import library_of, routes_features, routes_spacing
from app.engine.matching.dtw.placing import begins_in, place, sd_along_route, warp
from app.engine.matching.dtw.search import Deadline, Steps, best_places, window_costs
from app.engine.matching.dtw.signals import Centre, Resample, Treatment, as_it_is, derivative, difference, query_of
from app.engine.matching.entry import Bound, MatcherEntry
from app.engine.matching.problem import MatchProblem
from app.engine.matching.result import MatchResult

POINTS = 400
"""Most points of a query: a longer track is compared at wider spacing, as cost grows with their square."""
SCALE_SD = 0.1
"""Of the odometry, where no region says better."""
TOO_SHORT = "the track is too short to compare: walk on"
NO_STRETCH = "no route is as long as the track"


@dataclass(frozen=True, slots=True)
class WindowParameters:
    """Parameters of DTW over windows.

    Attributes
    ----------
    spacing_m : float, m
        Distance at which profile and routes are compared; 0 takes the routes' own.
    resample : Resample
        Whether the profile's points are equally far apart in way or in time.
    centre : Centre
        How the sensor's offset is taken out; ``mean`` compares each window less its mean.
    places : int
        Places that are looked at closely.
    separation_m : float, m
        Along a route, between two places.
    aside_sd_m : float, m
        How far beside the route's line people walk, one sigma.
    """

    spacing_m: float = 0.0
    resample: Resample = Resample.DISTANCE
    centre: Centre = Centre.MEAN
    places: int = 20
    separation_m: float = 5.0
    aside_sd_m: float = 0.7


@dataclass(frozen=True, slots=True)
class BandedParameters:
    """Parameters of DTW over windows in a Sakoe-Chiba band.

    Attributes
    ----------
    radius : float
        Half width of the band, as a part of the window.
    spacing_m : float, m
        Distance at which profile and routes are compared; 0 takes the routes' own.
    resample : Resample
        Whether the profile's points are equally far apart in way or in time.
    centre : Centre
        How the sensor's offset is taken out; ``mean`` compares each window less its mean.
    places : int
        Places that are looked at closely.
    separation_m : float, m
        Along a route, between two places.
    aside_sd_m : float, m
        How far beside the route's line people walk, one sigma.
    """

    radius: float = 0.1
    spacing_m: float = 0.0
    resample: Resample = Resample.DISTANCE
    centre: Centre = Centre.MEAN
    places: int = 20
    separation_m: float = 5.0
    aside_sd_m: float = 0.7


@dataclass(frozen=True, slots=True)
class DerivativeParameters:
    """Parameters of derivative DTW over windows, which no offset of the sensor reaches.

    Attributes
    ----------
    spacing_m : float, m
        Distance at which profile and routes are compared; 0 takes the routes' own.
    resample : Resample
        Whether the profile's points are equally far apart in way or in time.
    places : int
        Places that are looked at closely.
    separation_m : float, m
        Along a route, between two places.
    aside_sd_m : float, m
        How far beside the route's line people walk, one sigma.
    """

    spacing_m: float = 0.0
    resample: Resample = Resample.DISTANCE
    places: int = 20
    separation_m: float = 5.0
    aside_sd_m: float = 0.7


AnyParameters = WindowParameters | BandedParameters | DerivativeParameters


class WindowMatcher:
    """DTW over windows; its children say which pairs and steps a path may take, and what is compared."""

    steps = Steps.CLASSIC

    def __init__(self, parameters: AnyParameters) -> None:
        self.parameters = parameters

    def band(self, n: int) -> Band | None:
        """Pairs that a path may go through, for windows of ``n`` points."""
        return full_band(n, n)

    def treatment(self) -> tuple[Treatment, bool]:
        """What is compared, and whether less each window's mean."""
        centre = getattr(self.parameters, "centre", Centre.NONE)
        return (difference if centre is Centre.DIFFERENCE else as_it_is), centre is Centre.MEAN

    def match(self, problem: MatchProblem) -> MatchResult:
        """See :meth:`app.engine.matching.Matcher.match`."""
        p, deadline = self.parameters, Deadline(problem.deadline_s)
        spacing_m = routes_spacing(problem, p.spacing_m, POINTS)
        features = routes_features(problem)
        treatment, centred = self.treatment()
        query = query_of(problem, features, spacing_m, treatment, resample=p.resample)
        band = None if query is None else self.band(len(query))
        if query is None or band is None:
            return conclude(problem, [], evaluated=0, note=TOO_SHORT)
        library = library_of(problem.routes, features, spacing_m, treatment)
        n = len(query)
        if library is None or not library.runs(n).any():
            return conclude(problem, [], evaluated=0, note=NO_STRETCH)
        costs = window_costs(query.values, library, band, self.steps, centred=centred, deadline=deadline)
        total = np.where(begins_in(problem.region, library), costs.total, np.inf)
        values = query.values - query.values.mean(axis=0) if centred else query.values
        ends = _ends_sd(problem)
        candidates = []
        for first in best_places(total, library, places=p.places, separation_m=p.separation_m):
            stretch = library.values[first : first + n]
            stretch = stretch - stretch.mean(axis=0) if centred else stretch
            warping = warp(values, stretch, first, band, self.steps)
            if warping is not None:
                sd = sd_along_route(problem, library, costs.total, first, warping)
                candidates.append(place(problem, query, library, warping, float(np.hypot(sd, ends)), p.aside_sd_m))
        return conclude(problem, candidates, evaluated=costs.evaluated, converged=costs.complete)


class DtwMatcher(WindowMatcher):
    """Classic DTW."""


class ImprovedDtwMatcher(WindowMatcher):
    """DTW of Zhang 2021: each point of the profile once, inside the Itakura parallelogram."""

    steps = Steps.SKIPPING

    def band(self, n: int) -> Band | None:
        """The parallelogram."""
        return itakura_band(n, n)


class SakoeChibaDtwMatcher(WindowMatcher):
    """Classic steps inside a band of constant width."""

    parameters: BandedParameters

    def band(self, n: int) -> Band | None:
        """The band."""
        return sakoe_chiba_band(n, n, round(self.parameters.radius * n))


class DdtwMatcher(WindowMatcher):
    """DTW of derivatives."""

    def treatment(self) -> tuple[Treatment, bool]:
        """The derivative."""
        return derivative, False


class DdtwItakuraMatcher(DdtwMatcher):
    """DTW of derivatives inside the Itakura parallelogram."""

    def band(self, n: int) -> Band | None:
        """The parallelogram."""
        return itakura_band(n, n)


def _ends_sd(problem: MatchProblem) -> float:
    """By how much a window as long as the track says its end wrong when the track is not as long as it seems, m."""
    scale_sd = SCALE_SD if problem.region is None else problem.region.scale_sd
    return 0.5 * scale_sd * problem.track.length_m


def _entry(
    name: str, summary: str, reference: str, parameters: type, create: Any, extra: dict[str, Bound] | None = None
) -> MatcherEntry:
    bounds = {
        "spacing_m": Bound(0.0, 10.0), "places": Bound(1, 200), "separation_m": Bound(0.5, 100.0),
        "aside_sd_m": Bound(0.05, 10.0),
    }  # fmt: skip
    return MatcherEntry(
        name=name,
        summary=summary,
        reference=reference,
        parameters=parameters,
        create=create,
        bounds=bounds | (extra or {}),
        needs_routes=True,
        dimensions=1,
        scales=("indoor", "route"),
    )


_ZHANG = "Zhang 2021 (Hangzhou Dianzi University)"
ENTRIES = (
    _entry(
        "dtw",
        "Dynamic time warping of the profile onto every window of the routes.",
        f"Sakoe and Chiba 1978, doi:10.1109/TASSP.1978.1163055; {_ZHANG}, chapter 3",
        WindowParameters,
        DtwMatcher,
    ),
    _entry(
        "improved_dtw",
        "Windows inside the Itakura parallelogram, with steps by which every reading counts once.",
        f"{_ZHANG}, section 3.1.2; Itakura 1975, doi:10.1109/TASSP.1975.1162641",
        WindowParameters,
        ImprovedDtwMatcher,
    ),
    _entry(
        "sakoe_chiba_dtw",
        "Windows inside a band about the diagonal.",
        "Sakoe and Chiba 1978, doi:10.1109/TASSP.1978.1163055",
        BandedParameters,
        SakoeChibaDtwMatcher,
        {"radius": Bound(0.01, 1.0)},
    ),
    _entry(
        "ddtw",
        "Derivatives of the profile onto those of every window: no offset of the sensor matters.",
        f"Keogh and Pazzani 2001, doi:10.1137/1.9781611972719.1; {_ZHANG}, section 4.1",
        DerivativeParameters,
        DdtwMatcher,
    ),
    _entry(
        "ddtw_itakura",
        "Derivatives onto those of every window, inside the Itakura parallelogram.",
        f"{_ZHANG}, chapter 4; Itakura 1975, doi:10.1109/TASSP.1975.1162641",
        DerivativeParameters,
        DdtwItakuraMatcher,
    ),
)
