"""Simulated fields and walks through them, for matchers: what is true is known."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import gaussian_filter

from app.engine.matching import MatchProblem, Profile, Region, RouteMap, Track, read_map, route_along
from app.engine.types import FeatureSet, Float64Array, GridMap

MEAN = {FeatureSet.VECTOR: (0.0, 30.0, -40.0), FeatureSet.HV: (30.0, -40.0), FeatureSet.TOTAL: (50.0,)}


def field_map(
    rng: np.random.Generator,
    *,
    features: FeatureSet = FeatureSet.VECTOR,
    shape: tuple[int, int] = (160, 200),
    cell_m: float = 0.5,
    length_m: float = 2.0,
    spread_ut: float = 6.0,
    sd_ut: float = 0.3,
) -> GridMap:
    """A smooth random field about the Earth's, everywhere mapped."""
    noise = rng.standard_normal((len(features.channels), *shape))
    smooth = np.stack([gaussian_filter(one, length_m / cell_m, mode="wrap") for one in noise])
    smooth *= spread_ut / smooth.std(axis=(1, 2), keepdims=True)
    mean = smooth + np.array(MEAN[features])[:, None, None]
    return GridMap(
        level_id="simulated",
        features=features,
        x0=-10.0,
        y0=-20.0,
        cell_m=cell_m,
        mean=mean.astype(np.float32),
        sd=np.full(mean.shape, sd_ut, dtype=np.float32),
        support=np.zeros(shape, dtype=np.float32),
        mapped_m=1.5,
        noise_sd=(0.0,) * len(features.channels),
    )


@dataclass(frozen=True, slots=True)
class Truth:
    """A problem and where the track truly is, shape (n,), m."""

    problem: MatchProblem
    x: Float64Array
    y: Float64Array

    def end_error(self, x: Float64Array, y: Float64Array) -> float:
        """Distance of a located track's last point from the truth, m."""
        return float(np.hypot(x[-1] - self.x[-1], y[-1] - self.y[-1]))


def winding_way(n: int, spacing_m: float, *, turns: float = 1.5) -> tuple[Float64Array, Float64Array]:
    """Points of a smooth way that bends to and fro, from the origin on, m."""
    heading = turns * np.sin(np.linspace(0.0, 2.0 * np.pi, n))
    x = np.concatenate([[0.0], np.cumsum(spacing_m * np.cos(heading[1:]))])
    y = np.concatenate([[0.0], np.cumsum(spacing_m * np.sin(heading[1:]))])
    return x, y


def walk_through(
    grid_map: GridMap,
    rng: np.random.Generator,
    *,
    start: tuple[float, float],
    n: int = 60,
    spacing_m: float = 0.7,
    shift: tuple[float, float] = (0.0, 0.0),
    rotation: float = 0.0,
    scale: float = 1.0,
    offset_ut: float = 0.0,
    offset_sd: float = 0.0,
    noise_ut: float = 0.2,
    region_sd: float | None = 5.0,
    turns: float = 1.5,
) -> Truth:
    """A way from ``start`` and the problem of finding it.

    The indicated track begins ``shift`` beside the truth and is turned by ``-rotation`` and stretched by ``1 / scale``:
    a matcher must shift by ``-shift``, turn by ``rotation`` and stretch by ``scale``.
    """
    x, y = winding_way(n, spacing_m, turns=turns)
    c, s = np.cos(-rotation), np.sin(-rotation)
    track_x = start[0] + shift[0] + (c * x - s * y) / scale
    track_y = start[1] + shift[1] + (s * x + c * y) / scale
    heading = np.arctan2(np.gradient(track_y), np.gradient(track_x))
    x, y = x + start[0], y + start[1]
    values = read_map(grid_map, grid_map.features, x, y).mean
    values = values + noise_ut * rng.standard_normal(values.shape) + offset_ut
    noise_sd = np.full(values.shape[1], max(noise_ut, 0.05))
    profile = Profile(grid_map.features, values, noise_sd, offset_sd).turned(-rotation)
    track = Track(np.arange(n, dtype=np.float64), track_x, track_y, heading, np.zeros((n, 2, 2)))
    region = None
    if region_sd is not None:
        region = Region(float(track_x[0]), float(track_y[0]), np.eye(2) * region_sd**2)
    return Truth(MatchProblem(profile, track, grid_map, region), x, y)


def with_routes(truth: Truth, ways: tuple[Float64Array, ...], spacing_m: float = 0.25) -> Truth:
    """The same with lines of the map to compare with; each of ``ways`` has shape (k, 2), m."""
    found = (route_along(truth.problem.grid_map, way, spacing_m) for way in ways)
    routes: tuple[RouteMap, ...] = tuple(route for route in found if route is not None)
    return replace(truth, problem=replace(truth.problem, routes=routes))
