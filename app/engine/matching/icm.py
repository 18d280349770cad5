"""Iterative contour matching: starts on one contour only, then a track that the contours bend into place."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from app.engine.kernels.following import ORDER, follow, places
from app.engine.matching.conclude import conclude, fit_candidate, independent_share
from app.engine.matching.contours import ContourMap
from app.engine.matching.drift import DriftModel
from app.engine.matching.entry import Bound, MatcherEntry
from app.engine.matching.placements import PlacementObjective
from app.engine.matching.problem import MatchProblem, Profile, common_features
from app.engine.matching.result import Candidate, MatchResult
from app.engine.matching.starts import SCALE_SD, TURN_SD, distinct, first_contour, sensor_offset, turns, uncalibrated
from app.engine.types import FeatureSet, Float32Array, Float64Array

_SETTLED = 0.1
"""Of minus twice a log likelihood: what another pass must bring to be followed by one more."""


class Criterion(StrEnum):
    """What the coarse search compares by."""

    MAD = "mad"
    MSD = "msd"


@dataclass(frozen=True, slots=True)
class IcmParameters:
    """Parameters of :class:`Icm`.

    Attributes
    ----------
    criterion : Criterion
        Of the coarse search.
    widening : float
        Standard deviations of the first reading by which its contour is widened.
    coarse : int
        Starts, told apart by the coarse search, from which contours are followed.
    passes : int
        Over each of the likeliest followed tracks, measured about what the pass before it found.
    kept : int
        Followed tracks, the likeliest, that are judged.
    apart_cells : float
        Starts nearer to a better one than this, in cells, are that one.
    start_cells : float
        Standard deviation, in cells, of such a start.
    reach_cells : float
        How far from its predicted point a contour is looked for, in cells.
    caution : float
        By how much readings count as noisier in the first pass, while contours are met far from where they are taken.
    gate : float
        Standard deviations of an innovation beyond which a contour is not followed.
    """

    criterion: Criterion = Criterion.MAD
    widening: float = 3.0
    coarse: int = 12
    passes: int = 4
    kept: int = 4
    apart_cells: float = 3.0
    start_cells: float = 2.0
    reach_cells: float = 12.0
    caution: float = 4.0
    gate: float = 4.0


@dataclass(frozen=True, slots=True)
class Icm:
    """Iterative contour matching.

    Coarse: the criterion over the whole track, but only for starts on the contour of the first reading, widened by its
    error, in the region's 3 sigma box. Fine: from the best starts on, each point is predicted from the one before and
    drawn to the nearest point of the contour of its reading, so that the errors of dead reckoning stop adding up. The
    placed track is bent, not rigid.

    Source: Cheng and Zhou, Ordnance Industry Automation 2026(5), doi:10.7690/bgzdh.2026.05.004, eq. 7 and 8. There the
    point is put *on* the contour; here it is moved by a Kalman gain, which does that as far as the motion's errors are
    large against the reading's (its limit), weighs both where they are not, carries what was learned of drift, turn and
    stretch on to the points that follow, and smooths the points before. So along a contour, where nothing is learned,
    the uncertainty grows, and the answer says so.
    """

    parameters: IcmParameters = IcmParameters()

    def match(self, problem: MatchProblem) -> MatchResult:
        """See :class:`app.engine.matching.Matcher`."""
        began = time.thread_time()
        starts, evaluated = self._starts(problem)
        follower = _Follower.of(problem, self.parameters)
        found: list[tuple[float, Float64Array, Float64Array]] = []
        for start in starts:
            if found and problem.deadline_s is not None and time.thread_time() - began > problem.deadline_s:
                break
            found.append(follower.followed(start))
        found.sort(key=lambda one: one[0])
        candidates = [follower.candidate(start, states) for _, start, states in found[: self.parameters.kept]]
        note = f"{len(found)} of {evaluated} starts on the first reading's contour were followed"
        return conclude(
            problem,
            candidates,
            evaluated=evaluated,
            iterations=1 + self.parameters.passes,
            converged=len(found) == len(starts),
            note=note if found else "the first reading's contour does not pass through the region",
        )

    def _starts(self, problem: MatchProblem) -> tuple[Float64Array, int]:
        """Best distinct starts, shape (k, 4): dx, dy (m), rotation (rad), scale; and how many were tried."""
        points = first_contour(problem, self.parameters.widening)
        if not len(points):
            return np.zeros((0, 4)), 0
        objective = PlacementObjective.of(
            problem, squared=self.parameters.criterion is Criterion.MSD, centred=uncalibrated(problem.profile)
        )
        angles = turns(problem)
        placements = np.ones((len(angles) * len(points), 4))
        placements[:, :2] = np.tile(points - problem.track.xy[0], (len(angles), 1))
        placements[:, 2] = np.repeat(angles, len(points))
        costs = objective.costs(placements)
        apart = self.parameters.apart_cells * problem.grid_map.cell_m
        kept = distinct(placements, costs, apart, self.parameters.coarse, problem.track.xy)
        return placements[kept], len(placements)


@dataclass(frozen=True, slots=True, eq=False)
class _Follower:
    """What following contours needs, made once for a problem; cells of the map throughout."""

    problem: MatchProblem
    profile: Profile
    parameters: IcmParameters
    contours: ContourMap
    drift: DriftModel
    variances: Float32Array

    @classmethod
    def of(cls, problem: MatchProblem, parameters: IcmParameters) -> _Follower:
        features = common_features(problem.profile.features, problem.grid_map.features)
        profile = problem.profile.as_features(features)
        contours = ContourMap.of(problem.grid_map, features)
        own = np.asarray(problem.grid_map.noise_sd, dtype=np.float64)
        if len(own) != len(profile.noise_sd):
            own = np.full(len(profile.noise_sd), np.sqrt((own**2).mean()))
        noise = profile.noise_sd**2 + own**2
        variances = (contours.sd.astype(np.float64) ** 2 + np.maximum(noise, 1e-8)[:, None, None]).astype(np.float32)
        return cls(problem, profile, parameters, contours, DriftModel.of(problem.track), variances)

    def followed(self, start: Float64Array) -> tuple[float, Float64Array, Float64Array]:
        """Cost, start and states of a track that follows contours from a start on."""
        states = np.zeros((len(self.profile), ORDER + len(self.profile.noise_sd)))
        cost, _ = self._follow(start, self._start_cov(), states, self.parameters.caution**2, about=False)
        return cost, start, states

    def candidate(self, start: Float64Array, states: Float64Array) -> Candidate:
        """The track of a start once more, measured about the states that came of it, and how well it is known."""
        states, cost = states.copy(), np.inf
        for _ in range(self.parameters.passes):
            before, kept = cost, states.copy()
            cost, _ = self._follow(start, self._start_cov(), states, 1.0, about=True)
            if cost > before - _SETTLED:
                states, cost = (kept, before) if cost > before else (states, cost)
                break
        put = self._placed(start, states, cost)
        fit = fit_candidate(self.problem, put, self.profile)
        bending = max(cost - fit.chi2 - fit.log_variance, 0.0)
        excess = max(fit.chi2 / fit.residual.size, 1.0) / independent_share(fit.residual / np.sqrt(fit.variance))
        _, P = self._follow(start, self._region_cov(), states.copy(), excess, about=True)
        return replace(put, cov=self._end_cov(states[-1], P), bending=bending)

    def _start_cov(self) -> Float64Array:
        return np.eye(2) * self.parameters.start_cells**2

    def _follow(
        self, start: Float64Array, spread: Float64Array, states: Float64Array, excess: float, *, about: bool
    ) -> tuple[float, Float64Array]:
        """Filter and smooth; ``states`` is read and written. Cost, and covariance of the last state."""
        cell, drift, track = self.problem.grid_map.cell_m, self.drift, self.problem.track
        m0, P0 = self._prior(start, spread)
        P = np.empty_like(P0)
        cost, _ = follow(
            self.contours.planes,
            self.variances * np.float32(excess) if excess != 1.0 else self.variances,
            (track.xy - track.xy[0]) / cell,
            drift.dt,
            self.profile.values,
            track.heading,
            self.profile.features is FeatureSet.VECTOR,
            self._origin(start),
            m0,
            P0,
            np.array([drift.walk, drift.rate_walk]) / cell**2,
            self.parameters.reach_cells,
            self.parameters.gate,
            about,
            states,
            P,
        )
        return float(cost), P

    def _origin(self, start: Float64Array) -> Float64Array:
        return self.contours.cells(self.problem.track.xy[0] + start[:2])

    def _prior(self, start: Float64Array, spread: Float64Array) -> tuple[Float64Array, Float64Array]:
        """Mean and covariance of the state before the first reading."""
        region, cell = self.problem.region, self.problem.grid_map.cell_m
        turn_sd, scale_sd = (TURN_SD, SCALE_SD) if region is None else (region.heading_sd, region.scale_sd)
        channels = len(self.profile.noise_sd)
        m0 = np.zeros(ORDER + channels)
        m0[6], m0[7] = start[2], start[3] - 1.0
        # contours are local: with an offset of many of their spacings, the first ones met are those of other places
        m0[ORDER:], offset_sd = sensor_offset(self.problem, self.profile, start)
        drift = np.repeat([self.drift.rate, self.drift.acceleration], 2) / cell**2
        P0 = np.diag(np.concatenate([[0.0, 0.0], drift, [turn_sd**2, scale_sd**2], offset_sd**2]))
        P0[:2, :2] = spread
        return m0, P0

    def _region_cov(self) -> Float64Array:
        """Of the start before any reading, square cells: what must be left where the field does not tell."""
        cell, region = self.problem.grid_map.cell_m, self.problem.region
        if region is not None:
            return region.cov / cell**2
        rows, columns = self.problem.grid_map.shape
        return np.diag([columns**2 / 12.0, rows**2 / 12.0])

    def _placed(self, start: Float64Array, states: Float64Array, cost: float) -> Candidate:
        cell, track = self.problem.grid_map.cell_m, self.problem.track
        away, origin = (track.xy - track.xy[0]) / cell, self._origin(start)
        xy = np.empty_like(away)
        places(origin, states, away, xy)
        xy = self.contours.metres(xy)
        return Candidate(xy[:, 0], xy[:, 1], cost, float(states[-1, 6]), 1.0 + float(states[-1, 7]))

    def _end_cov(self, state: Float64Array, P: Float64Array) -> Float64Array:
        """Covariance of the last point, m^2."""
        cell, track = self.problem.grid_map.cell_m, self.problem.track
        ax, ay = (track.xy[-1] - track.xy[0]) / cell
        c, s = np.cos(state[6]), np.sin(state[6])
        bx, by = c * ax - s * ay, s * ax + c * ay
        J = np.zeros((2, len(state)))
        J[0, 0] = J[1, 1] = 1.0
        J[:, 6] = (1.0 + state[7]) * np.array([-by, bx])
        J[:, 7] = bx, by
        cov: Float64Array = J @ P @ J.T * cell**2 + np.eye(2) * (1e-3 * cell) ** 2
        return cov


ENTRY = MatcherEntry(
    name="icm",
    summary="Starts on the contour of the first reading; contours then bend the track, so that drift stops adding up",
    reference="Cheng and Zhou 2026, doi:10.7690/bgzdh.2026.05.004",
    parameters=IcmParameters,
    create=Icm,
    bounds={
        "widening": Bound(0.5, 10.0),
        "coarse": Bound(1, 200),
        "passes": Bound(1, 20),
        "kept": Bound(1, 50),
        "apart_cells": Bound(0.5, 50.0),
        "start_cells": Bound(0.1, 50.0),
        "reach_cells": Bound(1.0, 100.0),
        "caution": Bound(1.0, 100.0),
        "gate": Bound(1.0, 20.0),
    },
    needs_heading=True,
)
