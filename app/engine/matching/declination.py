"""Declination-aided dead reckoning: a compass that the map corrects, and corrections at the nearest field.

After Bao, Shang and Shi 2019 (Chinese Journal of Sensors and Actuators, 10), part 2. Indoors a compass is wrong by what
steel turns the field; a map of the field's vector tells by how much at every place. Taken over: the deviation of the
map aligned with the walk by warping, corrections at the map point nearest in three components within a radius, the
Hausdorff distance that accepts the stretch between two corrections, and halving a stretch that fails. Different:
several beginnings within the region are tried, and a correction looks at some metres of readings in place of one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from app.engine.errors import InputError
from app.engine.matching.conclude import conclude
from app.engine.matching.dtw.bands import sakoe_chiba_band
from app.engine.matching.dtw.placing import warp
from app.engine.matching.dtw.search import Deadline, Steps
from app.engine.matching.entry import Bound, MatcherEntry
from app.engine.matching.field import read_map
from app.engine.matching.problem import MatchProblem, Region
from app.engine.matching.result import Candidate, MatchResult
from app.engine.types import ComplexArray, FeatureSet, Float64Array

_ALIGNED_M = 3.0
"""How far along the way the map's deviation may be moved to fit."""
_APART_M = 1.0
"""Between a correction's best point and the second best."""


@dataclass(frozen=True, slots=True)
class DeclinationParameters:
    """Parameters of declination-aided dead reckoning.

    Attributes
    ----------
    radius_m : float, m
        How far a correction may move the predicted position.
    every_m : float, m
        Way between two corrections.
    window_m : float, m
        Way up to a correction whose readings are compared.
    limit : float
        Hausdorff distance at which a stretch is accepted, in standard deviations of a reading's vector.
    starts : int
        Beginnings within the region that are tried.
    smooth : int
        Readings over which the compass is averaged.
    """

    radius_m: float = 2.0
    every_m: float = 8.0
    window_m: float = 4.0
    limit: float = 4.0
    starts: int = 6
    smooth: int = 5


@dataclass(frozen=True, slots=True)
class _Walk:
    """A track that the compass has turned: points before any shift, and vectors as its headings have them."""

    x: Float64Array
    y: Float64Array
    vectors: Float64Array


class DeclinationMatcher:
    """Dead reckoning by a compass less the map's deviation, corrected where the field says so."""

    def __init__(self, parameters: DeclinationParameters) -> None:
        self.parameters = parameters

    def match(self, problem: MatchProblem) -> MatchResult:
        """See :meth:`app.engine.matching.Matcher.match`."""
        deadline = Deadline(problem.deadline_s)
        for what, features in (("profile", problem.profile.features), ("grid_map", problem.grid_map.features)):
            if features is not FeatureSet.VECTOR:
                raise InputError(what, f"a compass needs vectors, and these are {features}: give the field's vector")
        if problem.region is None:
            raise InputError("region", "dead reckoning begins somewhere: give a region or an earlier result's place")
        if len(problem) < 3:
            return conclude(problem, [], evaluated=0, note="the track is too short to correct: walk on")
        candidates: list[Candidate] = []
        refused = 0
        starts = self._starts(problem, problem.region)
        for start in starts:
            if candidates and deadline.passed:
                break
            walk = self._turned(problem, start)
            shift, failed = self._corrected(problem, walk)
            refused += failed
            candidates.append(_candidate(problem, walk, shift, self._end_cov(problem, walk, shift[-1])))
        note = f"stretches not accepted: {refused}" if refused else ""
        complete = len(candidates) == len(starts)
        return conclude(problem, candidates, evaluated=len(candidates), converged=complete, note=note)

    def _starts(self, problem: MatchProblem, region: Region) -> list[Float64Array]:
        """Beginnings within three sigma whose horizontal and vertical field is most like the first readings."""
        step = max(problem.grid_map.cell_m, 0.5)
        wide, high = region.half_widths()
        grid = np.meshgrid(np.arange(-wide, wide + step, step), np.arange(-high, high + step, step))
        away = np.stack([part.ravel() for part in grid], axis=1)
        prior = np.einsum("ni,ni->n", away, np.linalg.solve(region.cov, away.T).T)
        away, prior = away[prior <= 9.0], prior[prior <= 9.0]
        first = problem.profile.as_features(FeatureSet.HV).values[0]
        mean = read_map(problem.grid_map, FeatureSet.HV, region.x + away[:, 0], region.y + away[:, 1]).mean
        cost = ((mean - first) ** 2).sum(axis=1) / (_variance(problem) / 3.0) + prior
        chosen: list[Float64Array] = [np.array([region.x, region.y])]
        for k in np.argsort(cost, kind="stable"):
            place = np.array([region.x, region.y]) + away[k]
            if len(chosen) == self.parameters.starts:
                break
            if min(float(np.hypot(*(place - other))) for other in chosen) >= _APART_M:
                chosen.append(place)
        return chosen[: self.parameters.starts]

    def _turned(self, problem: MatchProblem, start: Float64Array) -> _Walk:
        """The track with its headings by the compass less the map's deviation, which one warping aligns."""
        track, vectors = problem.track, problem.profile.values
        steps = np.diff(track.x) + 1j * np.diff(track.y)
        measured = vectors[:, 0] + 1j * vectors[:, 1]
        at, turns = complex(start[0], start[1]), np.empty(len(track), dtype=np.complex128)
        for k in range(len(track)):
            mean = read_map(problem.grid_map, FeatureSet.VECTOR, np.array([at.real]), np.array([at.imag])).mean[0]
            # turn of the track = direction of the field here less the direction in which the track has it
            turns[k] = complex(mean[0], mean[1]) * np.conj(measured[k])
            if k < len(steps):
                recent = turns[max(k - self.parameters.smooth + 1, 0) : k + 1].sum()
                at += steps[k] * complex(_unit(recent))
        way = _way(start, steps, self._smoothed(turns))
        mean = read_map(problem.grid_map, FeatureSet.VECTOR, way.real, way.imag).mean
        field = (mean[:, 0] + 1j * mean[:, 1])[_aligned(problem, mean)]
        turned = self._smoothed(field * np.conj(measured))
        way = _way(start, steps, turned)
        horizontal = measured * turned
        return _Walk(way.real, way.imag, np.stack([horizontal.real, horizontal.imag, vectors[:, 2]], axis=1))

    def _smoothed(self, turns: ComplexArray) -> ComplexArray:
        """Unit complex numbers: directions averaged over neighbours."""
        kernel = np.ones(min(self.parameters.smooth, len(turns)))
        return np.asarray(_unit(np.convolve(turns, kernel, mode="same")))

    def _corrected(self, problem: MatchProblem, walk: _Walk) -> tuple[Float64Array, int]:
        """Shift of each point, shape (n, 2), m, and how many stretches were not accepted."""
        p, n = self.parameters, len(problem)
        every, window = max(round(p.every_m / _per_point(problem)), 2), self._window(problem)
        limit = p.limit * float(np.sqrt(_variance(problem)))
        shift = np.zeros((n, 2))
        last, second, failed = 0, None, 0
        while last < n - 1:
            end = min(last + every, n - 1)
            for stop in (end, (last + end) // 2):  # halved where the whole is not accepted
                best, other = self._nearest(problem, walk, shift[last], stop, window)
                accepted = stop > last and _apart(problem, walk, last, stop, shift[last], best) <= limit
                if accepted:
                    break
            if not accepted and second is not None:  # the correction before was perhaps the wrong one of two
                shift[last:], second = second, None
                continue
            if not accepted:
                stop, best, other, failed = end, shift[last], None, failed + 1
            shift[last : stop + 1] = np.linspace(shift[last], best, stop + 1 - last)
            shift[stop:] = best
            last, second = stop, other
        return shift, failed

    def _nearest(
        self, problem: MatchProblem, walk: _Walk, shift: Float64Array, stop: int, window: int
    ) -> tuple[Float64Array, Float64Array | None]:
        """Shifts within the radius at which the last readings are nearest to the map's, best and second best."""
        shifts, cost = self._shifts(problem, walk, shift, stop, window)
        best = shifts[int(np.argmin(cost))]
        far = np.hypot(*(shifts - best).T) >= _APART_M
        return best, shifts[far][int(np.argmin(cost[far]))] if far.any() else None

    def _shifts(
        self, problem: MatchProblem, walk: _Walk, shift: Float64Array, stop: int, window: int
    ) -> tuple[Float64Array, Float64Array]:
        """Shifts (k, 2) within the radius about one, and the squared distance of the last readings at each, uT^2."""
        radius, axis = self.parameters.radius_m, self._axis(problem)
        away = np.stack([part.ravel() for part in np.meshgrid(axis, axis)], axis=1)
        shifts = shift + away[np.hypot(away[:, 0], away[:, 1]) <= radius]
        part = slice(max(stop + 1 - window, 0), stop + 1)
        x, y = walk.x[part][None, :] + shifts[:, [0]], walk.y[part][None, :] + shifts[:, [1]]
        mean = read_map(problem.grid_map, FeatureSet.VECTOR, x.ravel(), y.ravel()).mean.reshape(*x.shape, 3)
        return shifts, ((mean - walk.vectors[part]) ** 2).sum(axis=(1, 2))

    def _axis(self, problem: MatchProblem) -> Float64Array:
        """Offsets that are tried along x and along y, zero among them, m."""
        radius = self.parameters.radius_m
        steps = max(int(np.ceil(radius / max(problem.grid_map.cell_m / 2.0, 0.1))), 1)
        return np.linspace(-radius, radius, 2 * steps + 1)

    def _window(self, problem: MatchProblem) -> int:
        """Readings that a correction compares."""
        return max(round(self.parameters.window_m / _per_point(problem)), 2)

    def _end_cov(self, problem: MatchProblem, walk: _Walk, shift: Float64Array) -> Float64Array:
        """Covariance of the last point, m^2: of the shifts, each as likely as the last readings make it.

        Half of the readings count, as errors nearby are alike, and none is better than what the best shift leaves.
        """
        window = self._window(problem)
        shifts, cost = self._shifts(problem, walk, shift, len(problem) - 1, window)
        variance = max(_variance(problem), float(cost.min()) / window) / 3.0
        weight = np.exp(-0.25 * (cost - cost.min()) / variance)
        weight /= weight.sum()
        away = shifts - shift
        step = float(np.diff(self._axis(problem)[:2])[0])
        return np.asarray((weight[:, None] * away).T @ away + np.eye(2) * step**2 / 3.0)


def _per_point(problem: MatchProblem) -> float:
    """Way from a reading to the next, m."""
    return max(problem.track.length_m / max(len(problem) - 1, 1), 1e-3)


def hausdorff(a: Float64Array, b: Float64Array) -> float:
    """Greatest distance from a point of one set (k, d) to the other set (l, d), either way."""
    apart = np.sqrt(((a[:, None] - b[None]) ** 2).sum(axis=2))
    return float(max(apart.min(axis=1).max(), apart.min(axis=0).max()))


def _apart(
    problem: MatchProblem, walk: _Walk, last: int, stop: int, before: Float64Array, after: Float64Array
) -> float:
    """Hausdorff distance, uT, of readings and map between two corrections."""
    shift = np.linspace(before, after, stop + 1 - last)
    x, y = walk.x[last : stop + 1] + shift[:, 0], walk.y[last : stop + 1] + shift[:, 1]
    return hausdorff(walk.vectors[last : stop + 1], read_map(problem.grid_map, FeatureSet.VECTOR, x, y).mean)


def _aligned(problem: MatchProblem, mean: Float64Array) -> Float64Array:
    """For each reading, the point of the predicted way whose field it is, by warping what needs no heading."""
    query = problem.profile.as_features(FeatureSet.HV).values
    n = len(query)
    along = np.stack([np.hypot(mean[:, 0], mean[:, 1]), mean[:, 2]], axis=1)
    band = sakoe_chiba_band(n, n, max(round(_ALIGNED_M / _per_point(problem)), 1))
    warping = warp(query, along, 0, band, Steps.CLASSIC)
    assert warping is not None, "a band about the diagonal always holds a path"  # noqa: S101
    i, j = warping.pairs.T
    return np.asarray(np.rint(np.bincount(i, weights=j) / np.bincount(i)).astype(np.int64))


def _candidate(problem: MatchProblem, walk: _Walk, shift: Float64Array, cov: Float64Array) -> Candidate:
    x, y = walk.x + shift[:, 0], walk.y + shift[:, 1]
    track = problem.track
    moved, own = np.diff(x) + 1j * np.diff(y), np.diff(track.x) + 1j * np.diff(track.y)
    residual = walk.vectors - read_map(problem.grid_map, FeatureSet.VECTOR, x, y).mean
    return Candidate(
        x=x,
        y=y,
        cost=float(np.sqrt((residual**2).mean())),
        rotation=float(np.angle(np.sum(moved * np.conj(own)))),
        scale=float(np.abs(moved).sum() / max(track.length_m, 1e-6)),
        cov=cov,
    )


def _way(start: Float64Array, steps: ComplexArray, turns: ComplexArray) -> ComplexArray:
    """Complex points of a way whose steps are turned by the mean of their ends' turns."""
    moved = steps * _unit(turns[:-1] + turns[1:])
    return np.asarray(complex(start[0], start[1]) + np.concatenate([[0.0], np.cumsum(moved)]))


def _unit(z: ComplexArray) -> ComplexArray:
    """Complex numbers of length one; one where there is no direction."""
    size = np.abs(z)
    return np.asarray(np.where(size > 0.0, z / np.where(size > 0.0, size, 1.0), 1.0))


def _variance(problem: MatchProblem) -> float:
    """Of a reading's vector less the map's, uT^2, three components together."""
    own, walk = problem.profile.noise_sd, np.asarray(problem.grid_map.noise_sd)
    mapped = problem.grid_map.sd[:, problem.grid_map.mapped]
    sd2 = (mapped.astype(np.float64) ** 2).mean(axis=1) if mapped.size else np.zeros(3)
    return max(float((own**2).sum() + (walk**2).sum() + sd2.sum()), 1e-6)


ENTRY = MatcherEntry(
    name="declination_aided",
    summary="Dead reckoning by a compass that the map's deviation corrects, with corrections at the nearest field.",
    reference="Bao, Shang and Shi 2019 (Chinese Journal of Sensors and Actuators, 10), part 2",
    parameters=DeclinationParameters,
    create=DeclinationMatcher,
    bounds={
        "radius_m": Bound(0.2, 50.0),
        "every_m": Bound(0.5, 500.0),
        "window_m": Bound(0.5, 100.0),
        "limit": Bound(0.5, 100.0),
        "starts": Bound(1, 100),
        "smooth": Bound(1, 100),
    },
    features=(FeatureSet.VECTOR,),
    needs_region=True,
    scales=("indoor",),
)
