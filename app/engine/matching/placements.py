"""One objective for searches over placements: shift, rotation and scale of a whole track on a map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from app.engine.kernels.contour import placements_mad
from app.engine.matching.field import features_of
from app.engine.matching.problem import MatchProblem, common_features
from app.engine.matching.result import Candidate
from app.engine.types import FeatureSet, Float32Array, Float64Array, GridMap


@dataclass(frozen=True, slots=True, eq=False)
class PlacementObjective:
    """Mean difference of a track's readings from the map, at any number of placements at once.

    A placement ``(dx, dy, rotation, scale)`` turns (rad, counter-clockwise) and stretches the track about its first
    point, then shifts it (m); vectors turn with it.

    Attributes
    ----------
    grid_map : GridMap
    planes : array, shape (channels, rows, columns), float32, uT
        The map in the features that are compared.
    xy : array, shape (n, 2), m, level frame
        The track as indicated.
    values : array, shape (n, channels), uT
    turning : bool
        Whether the first two channels are a vector of the level frame.
    squared : bool
        MSD instead of MAD.
    centred : bool
        An offset of each channel costs nothing.
    mapped : float
        A placement with a smaller share of its points on mapped ground costs infinity.
    """

    grid_map: GridMap
    planes: Float32Array
    xy: Float64Array
    values: Float64Array
    turning: bool
    squared: bool = False
    centred: bool = False
    mapped: float = 0.5

    @classmethod
    def of(
        cls, problem: MatchProblem, *, squared: bool = False, centred: bool = False, mapped: float = 0.5
    ) -> PlacementObjective:
        """Of a problem, in the features that its profile and its map have in common.

        An offset of the device turns with it, so centring takes it off vectors only as far as the track is straight.
        """
        grid_map, features = problem.grid_map, common_features(problem.profile.features, problem.grid_map.features)
        planes = np.ascontiguousarray(features_of(grid_map, features)[0])
        values = problem.profile.as_features(features).values
        turning = features is FeatureSet.VECTOR
        return cls(grid_map, planes, problem.track.xy, values, turning, squared, centred, mapped)

    def costs(self, placements: Float64Array) -> Float64Array:
        """Cost of placements of shape (p, 4); shape (p,), uT (uT^2 if squared), infinite off the map."""
        cell = self.grid_map.cell_m
        placements = np.asarray(placements, dtype=np.float64).reshape(-1, 4)
        poses = placements.copy()
        poses[:, 0] = (self.xy[0, 0] + placements[:, 0] - self.grid_map.x0) / cell
        poses[:, 1] = (self.xy[0, 1] + placements[:, 1] - self.grid_map.y0) / cell
        cost, share = np.empty(len(poses)), np.empty(len(poses))
        placements_mad(
            self.planes,
            self.grid_map.support,
            self.grid_map.mapped_m,
            (self.xy - self.xy[0]) / cell,
            self.values,
            poses,
            self.squared,
            self.centred,
            self.turning,
            np.empty((self.values.shape[1], len(self.values))),
            cost,
            share,
        )
        cost[(share < self.mapped) | (share == 0.0)] = np.inf
        return cost

    def candidate(self, placement: Float64Array, cost: float) -> Candidate:
        """The track at a placement of shape (4,)."""
        dx, dy, rotation, scale = (float(value) for value in placement)
        x, y = placed(self.xy, dx, dy, rotation, scale)
        return Candidate(x, y, cost, rotation, scale)


def placed(
    xy: Float64Array,
    dx: Float64Array | float,
    dy: Float64Array | float,
    rotation: Float64Array | float,
    scale: Float64Array | float,
) -> tuple[Float64Array, Float64Array]:
    """A track (n, 2), turned and stretched about its first point and shifted: x and y, shape (n,).

    Placements of shape (p, 1) give (p, n).
    """
    away = xy - xy[0]
    c, s = scale * np.cos(rotation), scale * np.sin(rotation)
    return xy[0, 0] + dx + c * away[:, 0] - s * away[:, 1], xy[0, 1] + dy + s * away[:, 0] + c * away[:, 1]


def turned_vectors(values: Float64Array, rotations: Float64Array) -> Float64Array:
    """Vectors (n, 3) turned counter-clockwise about the vertical by each rotation (p,), rad; shape (p, n, 3)."""
    c, s = np.cos(rotations)[:, None], np.sin(rotations)[:, None]
    x, y, z = values.T
    return np.stack([c * x - s * y, s * x + c * y, np.broadcast_to(z, (len(rotations), len(z)))], axis=2)
