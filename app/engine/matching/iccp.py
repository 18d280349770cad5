"""Iterative closest contour point: the track is drawn to the contours of its readings, as a whole, again and again."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np

from app.engine.errors import InputError
from app.engine.matching.conclude import conclude
from app.engine.matching.contours import ContourMap
from app.engine.matching.correspondence import Correspondence, associated_contours, nearest_contours, nearest_vectors
from app.engine.matching.entry import Bound, MatcherEntry
from app.engine.matching.field import read_map
from app.engine.matching.placements import PlacementObjective, placed
from app.engine.matching.problem import MatchProblem, Profile, common_features
from app.engine.matching.result import MatchResult
from app.engine.matching.starts import SCALE_SD, distinct, lattice, level_offset, sensor_offset, turns, uncalibrated
from app.engine.types import FeatureSet, Float64Array

_LEAST, _MOST = 0.5, 2.0
"""Scales that the search keeps within."""


@dataclass(frozen=True, slots=True)
class IccpParameters:
    """Parameters of the closest contour searches.

    Attributes
    ----------
    coarse : bool
        Begin at the best places of a MAD search over the region, instead of where the track is thought to be.
    coarse_cells : float
        Step of that search, in cells.
    starts : int
        Of its places that are begun at.
    radius_cells : float
        How far a point looks for its contour, in cells.
    max_iterations : int
        After which a track that has not come to rest is taken as it lies.
    settled_cells : float
        Motion of the track, in cells, below which it has come to rest.
    basin_cells : float
        How far beside its start the winner is begun again, to see whether it falls into the same place.
    """

    coarse: bool = True
    coarse_cells: float = 2.0
    starts: int = 6
    radius_cells: float = 8.0
    max_iterations: int = 100
    settled_cells: float = 2e-3
    basin_cells: float = 2.0


@dataclass(frozen=True, slots=True)
class Rest:
    """Where a search came to rest.

    Attributes
    ----------
    placement : array, shape (4,)
        dx, dy (m), rotation (rad), scale.
    moved : float, m
        Of the track's points in the mean, from the start.
    iterations : int
    converged : bool
    """

    placement: Float64Array
    moved: float
    iterations: int
    converged: bool


@dataclass(frozen=True, slots=True)
class Iccp:
    """Iterative closest contour point.

    Each point of the track is drawn to the nearest point of the contour of its reading; the rigid motion that fits all
    of these best in the sense of weighted least squares (closed form in the plane) is applied to the track; and again,
    until it rests. Weights tell how well a reading places its contour. A map of several channels has as many contours
    for a point, each of which draws.

    Source: the method as reviewed by Lu, Wei, Ji and Yuan, Navigation Positioning and Timing 9(2), 2022,
    doi:10.19306/j.cnki.2095-8110.2022.02.015, section 1.2.2, with the variants it names: scale, vector components,
    probabilistic data association. It finds the nearest rest, not the best: hence the coarse search before it, and the
    starts beside the winner after it, of which the evidence tells.
    """

    parameters: IccpParameters = IccpParameters()
    correspondence: Correspondence = nearest_contours
    scaled: bool = False
    features: tuple[FeatureSet, ...] = (FeatureSet.VECTOR, FeatureSet.HV, FeatureSet.TOTAL)

    def match(self, problem: MatchProblem) -> MatchResult:
        """See :class:`app.engine.matching.Matcher`."""
        began = time.thread_time()
        features = common_features(problem.profile.features, problem.grid_map.features)
        if features not in self.features:
            raise InputError("features", f"{features} has one component; use the variant for contours of a single one")
        search = _Search.of(problem, self)
        starts, evaluated = self._starts(problem, search.objective)
        rests = [search.rest(starts[0])]
        for start in starts[1:]:
            if problem.deadline_s is not None and time.thread_time() - began > problem.deadline_s:
                break
            rests.append(search.rest(start))
        ended = len(rests) == len(starts)
        costs = search.objective.costs(np.array([one.placement for one in rests]))
        first = int(np.argmin(costs))
        best = rests[first]
        note = f"came to rest {best.moved:.3g} m from its start in {best.iterations} iterations"
        if ended and np.isfinite(costs[first]):
            beside = [search.rest(one) for one in self._beside(problem, starts[first])]
            same = sum(search.apart(one.placement, best.placement) <= problem.grid_map.cell_m for one in beside)
            note += (
                f"; {same} of {len(beside)} starts {self.parameters.basin_cells:g} cells beside it fall into that place"
            )
            rests += beside
        places = np.array([one.placement for one in rests])
        costs = search.objective.costs(places)
        candidates = [search.objective.candidate(p, float(c)) for p, c in zip(places, costs, strict=True) if c < np.inf]
        return conclude(
            problem,
            candidates,
            evaluated=evaluated + sum(one.iterations for one in rests),
            iterations=best.iterations,
            converged=best.converged and ended,
            note=note if candidates else "no start came to rest on mapped ground",
        )

    def _starts(self, problem: MatchProblem, objective: PlacementObjective) -> tuple[Float64Array, int]:
        """Placements to begin at, shape (k, 4), best first, and how many were tried."""
        region = problem.region
        thought = np.array([[0.0, 0.0, 0.0, 1.0]])
        if region is not None:
            thought[0, :2] = np.array([region.x, region.y]) - problem.track.xy[0]
        if not self.parameters.coarse:
            return thought, 0
        shifts, angles = lattice(problem, self.parameters.coarse_cells * problem.grid_map.cell_m), turns(problem)
        scale_sd = SCALE_SD if region is None else region.scale_sd
        scales = np.array([1.0, 1.0 - scale_sd, 1.0 + scale_sd]) if self.scaled and scale_sd > 0.0 else np.ones(1)
        shapes = np.stack(np.meshgrid(angles, scales, indexing="ij"), axis=2).reshape(-1, 2)
        placements = np.concatenate([np.tile(shifts, (len(shapes), 1)), np.repeat(shapes, len(shifts), axis=0)], axis=1)
        costs = objective.costs(placements)
        apart = 2.0 * self.parameters.coarse_cells * problem.grid_map.cell_m
        kept = distinct(placements, costs, apart, self.parameters.starts, problem.track.xy)
        return (placements[kept] if kept else thought), len(placements)

    def _beside(self, problem: MatchProblem, start: Float64Array) -> list[Float64Array]:
        step = self.parameters.basin_cells * problem.grid_map.cell_m
        return [
            start + np.array([dx, dy, 0.0, 0.0]) for dx, dy in ((step, 0.0), (-step, 0.0), (0.0, step), (0.0, -step))
        ]


@dataclass(frozen=True, slots=True, eq=False)
class _Search:
    """What an iteration needs, made once for a problem."""

    problem: MatchProblem
    method: Iccp
    profile: Profile
    contours: ContourMap
    objective: PlacementObjective
    walks: Float64Array

    @classmethod
    def of(cls, problem: MatchProblem, method: Iccp) -> _Search:
        features = common_features(problem.profile.features, problem.grid_map.features)
        profile = problem.profile.as_features(features)
        own = np.asarray(problem.grid_map.noise_sd, dtype=np.float64)
        if len(own) != len(profile.noise_sd):
            own = np.full(len(profile.noise_sd), np.sqrt((own**2).mean()))
        objective = PlacementObjective.of(problem, centred=uncalibrated(profile))
        return cls(problem, method, profile, ContourMap.of(problem.grid_map, features), objective, own)

    def rest(self, start: Float64Array) -> Rest:
        """Iterate from a start until the track rests."""
        cell, parameters = self.problem.grid_map.cell_m, self.method.parameters
        placement, first = start, self._points(start)
        points = first
        for k in range(parameters.max_iterations):
            after = self._step(placement, points)
            if after is None:
                return Rest(placement, 0.0, k, False)
            placement, before = after, points
            points = self._points(placement)
            if np.hypot(*(points - before).T).max() < parameters.settled_cells * cell:
                return Rest(placement, float(np.hypot(*(points - first).T).mean()), k + 1, True)
        return Rest(placement, float(np.hypot(*(points - first).T).mean()), parameters.max_iterations, False)

    def apart(self, one: Float64Array, other: Float64Array) -> float:
        """Mean distance of the track's points at two placements, m."""
        return float(np.hypot(*(self._points(one) - self._points(other)).T).mean())

    def _points(self, placement: Float64Array) -> Float64Array:
        return np.stack(placed(self.problem.track.xy, *(float(part) for part in placement)), axis=1)

    def _step(self, placement: Float64Array, points: Float64Array) -> Float64Array | None:
        """The placement after one iteration; None if too few points found a contour."""
        values = self.profile.turned(float(placement[2])).values
        offset, _ = sensor_offset(self.problem, self.profile, placement)
        values = values - level_offset(offset, self.profile.features, self.problem.track, float(placement[2]))
        reading = read_map(self.problem.grid_map, self.profile.features, points[:, 0], points[:, 1])
        sd = np.sqrt(reading.sd**2 + self.profile.noise_sd**2 + self.walks**2)
        radius = self.method.parameters.radius_cells * self.problem.grid_map.cell_m
        pull = self.method.correspondence(self.contours, points, values, sd, radius)
        k = pull.weights.shape[1]
        weights = pull.weights.reshape(-1)
        if np.count_nonzero(pull.weights.max(axis=1)) < min(3, len(points)) or weights.sum() <= 0.0:
            return None
        turn, stretch, shift = fit_similarity(
            np.repeat(points, k, axis=0), pull.targets.reshape(-1, 2), weights, scaled=self.method.scaled
        )
        scale = float(np.clip(placement[3] * stretch, _LEAST, _MOST))
        stretch = scale / placement[3]
        c, s = stretch * np.cos(turn), stretch * np.sin(turn)
        centre = (weights[:, None] * np.repeat(points, k, axis=0)).sum(axis=0) / weights.sum()
        away = points[0] - centre
        begin = centre + shift + (c * away[0] - s * away[1], s * away[0] + c * away[1])
        return np.array([*(begin - self.problem.track.xy[0]), placement[2] + turn, scale])


def fit_similarity(
    points: Float64Array, targets: Float64Array, weights: Float64Array, *, scaled: bool = False
) -> tuple[float, float, Float64Array]:
    """Turn, stretch and shift of the weighted centre that bring points nearest to their targets.

    Minimizes ``sum w |t - s R (p - centre) - centre - shift|^2``; in the plane a point is a complex number, and the
    best ``s exp(i turn)`` their weighted regression (Procrustes in closed form, where more dimensions need an SVD).

    Parameters
    ----------
    points, targets : array, shape (n, 2)
    weights : array, shape (n,)
        Not negative, not all zero.
    scaled : bool
        False keeps the stretch at one.
    """
    w = weights / weights.sum()
    p, t = points[:, 0] + 1j * points[:, 1], targets[:, 0] + 1j * targets[:, 1]
    mean_p, mean_t = (w * p).sum(), (w * t).sum()
    along = (w * np.conj(p - mean_p) * (t - mean_t)).sum()
    power = float((w * np.abs(p - mean_p) ** 2).sum())
    turn = float(np.angle(along)) if abs(along) > 1e-12 * max(power, 1e-300) else 0.0
    stretch = float(abs(along) / power) if scaled and power > 0.0 else 1.0
    shift = mean_t - mean_p
    return turn, max(stretch, 1e-3), np.array([shift.real, shift.imag])


def rigid(parameters: IccpParameters) -> Iccp:
    """Turned and shifted only."""
    return Iccp(parameters)


def affine(parameters: IccpParameters) -> Iccp:
    """Stretched as well."""
    return Iccp(parameters, scaled=True)


def vector(parameters: IccpParameters) -> Iccp:
    """Drawn to the nearest point in all components together."""
    return Iccp(parameters, nearest_vectors, features=(FeatureSet.VECTOR, FeatureSet.HV))


def associated(parameters: IccpParameters) -> Iccp:
    """Drawn to several pseudo-measurements within the noise, fused."""
    return Iccp(parameters, associated_contours)


_BOUNDS = {
    "coarse_cells": Bound(0.5, 20.0),
    "starts": Bound(1, 100),
    "radius_cells": Bound(1.0, 100.0),
    "max_iterations": Bound(1, 10000),
    "settled_cells": Bound(1e-6, 1.0),
    "basin_cells": Bound(0.1, 20.0),
}
_ENTRY = MatcherEntry(
    name="iccp",
    summary="Draws each point to the nearest contour of its reading and fits a rigid motion, until the track rests",
    reference="Lu et al. 2022, doi:10.19306/j.cnki.2095-8110.2022.02.015, section 1.2.2",
    parameters=IccpParameters,
    create=rigid,
    bounds=_BOUNDS,
)
ENTRIES = (
    _ENTRY,
    replace(
        _ENTRY,
        name="iccp_affine",
        summary="Closest contours with a scale: for strides or speeds that are off as a whole",
        create=affine,
    ),
    replace(
        _ENTRY,
        name="iccp_vector",
        summary="Closest point by all field components together: each point is drawn to a place, not to a line",
        create=vector,
        features=(FeatureSet.VECTOR, FeatureSet.HV),
    ),
    replace(
        _ENTRY,
        name="iccp_pda",
        summary="Closest contours of several values within the noise, fused by probabilistic data association",
        create=associated,
    ),
)
