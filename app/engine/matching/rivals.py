"""Places that a search did not name, but that fit: found on a coarse lattice of shifts, for the judgement alone."""

from __future__ import annotations

import numpy as np

from app.engine.matching.field import read_map
from app.engine.matching.problem import MatchProblem, Profile
from app.engine.matching.result import Candidate
from app.engine.types import Float64Array

_POINTS = 32
_SIDE = 31
_FINE = 5
_RIVALS = 6


def rival_places(problem: MatchProblem, profile: Profile, shape: Candidate) -> list[Candidate]:
    """Shifts of a placed track that fit best among all of the region, coarse to fine, in no order.

    A lattice of 31 x 31 shifts over the region (the whole map without one) is read at 32 points of the track; the six
    best that are no neighbours of one another are moved within their lattice cell. Costs are NaN: no search made them.

    Parameters
    ----------
    problem : MatchProblem
    profile : Profile
        In the features that are compared.
    shape : Candidate
        What is shifted.
    """
    east, north = _axes(problem, shape)
    lattice = np.stack([part.ravel() for part in np.meshgrid(east, north, indexing="ij")], axis=1)
    step = np.array([_gap(east), _gap(north)])
    costs = _costs(problem, profile, shape, lattice)
    fine = np.linspace(-0.5, 0.5, _FINE)
    around = np.stack([part.ravel() for part in np.meshgrid(fine, fine, indexing="ij")], axis=1) * step
    rivals = []
    for start in _peaks(costs.reshape(len(east), len(north)), _RIVALS):
        tried = lattice[start] + around
        dx, dy = tried[int(np.argmin(_costs(problem, profile, shape, tried)))]
        rivals.append(Candidate(shape.x + dx, shape.y + dy, np.nan, shape.rotation, shape.scale))
    return rivals


def _axes(problem: MatchProblem, shape: Candidate) -> tuple[Float64Array, Float64Array]:
    """Shifts east and north that bring the first point all over the region, m."""
    x_min, y_min, x_max, y_max = problem.grid_map.extent
    if problem.region is not None:
        wide, high = problem.region.half_widths()
        x_min, x_max = problem.region.x - wide, problem.region.x + wide
        y_min, y_max = problem.region.y - high, problem.region.y + high
    return np.linspace(x_min, x_max, _SIDE) - shape.x[0], np.linspace(y_min, y_max, _SIDE) - shape.y[0]


def _gap(axis: Float64Array) -> float:
    return float(axis[1] - axis[0])


def _costs(problem: MatchProblem, profile: Profile, shape: Candidate, shifts: Float64Array) -> Float64Array:
    """Mean squared standardized difference, less the sensor's offset if it has one; infinite on unmapped ground."""
    few = np.unique(np.linspace(0, len(shape.x) - 1, min(len(shape.x), _POINTS)).round().astype(np.int64))
    x = (shifts[:, :1] + shape.x[few]).ravel()
    y = (shifts[:, 1:] + shape.y[few]).ravel()
    reading = read_map(problem.grid_map, profile.features, x, y)
    form = (len(shifts), len(few), -1)
    difference = profile.turned(shape.rotation).values[few] - reading.mean.reshape(form)
    weight = 1.0 / (reading.sd.reshape(form) ** 2 + profile.noise_sd**2 + 1e-12)
    if profile.offset_sd > 0.0:
        total = weight.sum(axis=1, keepdims=True) + profile.offset_sd**-2
        difference = difference - (weight * difference).sum(axis=1, keepdims=True) / total
    costs = (weight * difference**2).mean(axis=(1, 2)) - np.log(weight).mean(axis=(1, 2))
    mapped = reading.mapped.reshape(form[:2]).mean(axis=1)
    return np.asarray(np.where(mapped >= 0.5, costs, np.inf), dtype=np.float64)


def _peaks(costs: Float64Array, count: int) -> list[int]:
    """Indices (flat) of the cheapest nodes, none a neighbour of a cheaper one taken."""
    left = costs.copy()
    found = []
    for _ in range(count):
        at = int(np.argmin(left))
        r, c = divmod(at, left.shape[1])
        if not np.isfinite(left[r, c]):
            break
        found.append(at)
        left[max(r - 1, 0) : r + 2, max(c - 1, 0) : c + 2] = np.inf
    return found
