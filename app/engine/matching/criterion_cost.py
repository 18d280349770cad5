"""Any criterion as a cost of placements anywhere: through the fast kernel where there is one, else by its formula."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from app.engine.matching.criteria import Criterion, as_cost, centred, evaluate
from app.engine.matching.field import features_of, read_map
from app.engine.matching.placements import PlacementObjective, placed, turned_vectors
from app.engine.matching.problem import Profile
from app.engine.types import FeatureSet, Float64Array, GridMap

_FAST = (Criterion.MAD, Criterion.AD, Criterion.MSD, Criterion.SD)
_CHUNK = 500_000
"""Readings that the plain way holds at once."""


@dataclass(frozen=True, slots=True, eq=False)
class CriterionCost:
    """A criterion of a track's readings against the map's, always less is better.

    Attributes
    ----------
    criterion : Criterion
    objective : PlacementObjective
    features : FeatureSet
    """

    criterion: Criterion
    objective: PlacementObjective
    features: FeatureSet

    @classmethod
    def of(
        cls,
        criterion: Criterion,
        grid_map: GridMap,
        profile: Profile,
        xy: Float64Array,
        values: Float64Array,
        *,
        centre: bool,
        mapped: float,
    ) -> CriterionCost:
        """Of points (n, 2), m, and readings (n, channels), uT, that stand for a profile."""
        planes = np.ascontiguousarray(features_of(grid_map, profile.features)[0])
        turning, squared = profile.features is FeatureSet.VECTOR, criterion in (Criterion.MSD, Criterion.SD)
        objective = PlacementObjective(grid_map, planes, xy, values, turning, squared, centre, mapped)
        return cls(criterion, objective, profile.features)

    def __call__(self, placements: Float64Array) -> Float64Array:
        """Cost of placements (p, 4) about the first point; shape (p,), infinite off the map."""
        values = self.objective.values
        if self.criterion in _FAST:
            sums = self.criterion in (Criterion.AD, Criterion.SD)
            return self.objective.costs(placements) * (values.size if sums else 1)
        n, channels = values.shape
        step = max(1, _CHUNK // (n * (n if self.criterion is Criterion.HAUSDORFF else channels)))
        parts = [self._plainly(placements[k : k + step]) for k in range(0, len(placements), step)]
        return np.concatenate(parts) if parts else np.empty(0)

    def _plainly(self, placements: Float64Array) -> Float64Array:
        one, (n, channels) = self.objective, self.objective.values.shape
        x, y = placed(one.xy, *placements.T[:, :, None])
        reading = read_map(one.grid_map, self.features, x.ravel(), y.ravel())
        readings, weight = reading.mean.reshape(-1, n, channels), reading.mapped.reshape(-1, n).astype(np.float64)
        measured = one.values[None]
        if one.turning:
            measured = turned_vectors(one.values, placements[:, 2])
        if one.centred:
            measured = centred(measured, readings, weight)
        cost = as_cost(self.criterion, evaluate(self.criterion, measured, readings, weight))
        return np.where(weight.mean(axis=1) >= one.mapped, cost, np.inf)
