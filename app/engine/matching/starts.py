"""Where searches begin: places that a region and the first reading allow, told apart by the track's two ends."""

from __future__ import annotations

import numpy as np

from app.engine.matching.contours import ContourMap
from app.engine.matching.field import read_map
from app.engine.matching.placements import placed
from app.engine.matching.problem import MatchProblem, Profile, Track, common_features
from app.engine.types import FeatureSet, Float64Array

TURN_SD, SCALE_SD = 0.1, 0.1
"""rad, -: of the track's shape where no region says better."""
_MOST_ANGLES = 9
_SORTED = 1000


def first_contour(problem: MatchProblem, widening: float, sigmas: float = 3.0) -> Float64Array:
    """Points of the region's box where the map allows the first reading, shape (k, 2), m, likeliest beforehand first.

    A vector is compared by what does not turn with the track.

    Parameters
    ----------
    problem : MatchProblem
    widening : float
        Standard deviations of reading and map by which the contour is widened.
    sigmas : float
        Half sides of the box; without a region the whole map is searched.
    """
    grid_map, region = problem.grid_map, problem.region
    features = common_features(problem.profile.features, grid_map.features)
    features = FeatureSet.HV if features is FeatureSet.VECTOR else features
    profile = problem.profile.as_features(features)
    reach = np.full(2, np.inf) if region is None else np.maximum(region.half_widths(sigmas), grid_map.cell_m)
    centre = np.zeros(2) if region is None else np.array([region.x, region.y])
    box = None if region is None else (*(centre - reach), *(centre + reach))
    contours = ContourMap.of(grid_map, features, box)
    known = contours.sd[:, contours.grid_map.mapped]
    map_sd = np.median(known, axis=1) if known.size else np.zeros(len(profile.noise_sd))
    walks = float(np.mean(np.square(grid_map.noise_sd)))
    sd = np.sqrt(profile.noise_sd**2 + map_sd**2 + walks + profile.offset_sd**2)
    points = contours.band(profile.values[0], widening * sd)
    if region is None:
        return points
    away = points - centre
    away = away[np.all(np.abs(away) <= reach, axis=1)]
    nearness = np.einsum("ki,ij,kj->k", away, np.linalg.inv(region.cov), away)
    ordered: Float64Array = away[np.argsort(nearness, kind="stable")] + centre
    return ordered


def uncalibrated(profile: Profile) -> bool:
    """Whether the sensor's offset is larger than its noise, so that differences must be taken about their mean."""
    return bool(profile.offset_sd > float(profile.noise_sd.mean()))


def distinct(placements: Float64Array, costs: Float64Array, apart_m: float, most: int, xy: Float64Array) -> list[int]:
    """Indices of the best placements, none of which has both ends nearer than ``apart_m`` to those of a better one.

    Parameters
    ----------
    placements : array, shape (p, 4)
        dx, dy (m), rotation (rad), scale.
    costs : array, shape (p,)
    apart_m : float, m
    most : int
    xy : array, shape (n, 2), m
        The track, for where its end comes to lie.
    """
    reach = xy[-1] - xy[0]
    c, s = placements[:, 3] * np.cos(placements[:, 2]), placements[:, 3] * np.sin(placements[:, 2])
    ends = placements[:, :2] + np.stack([c * reach[0] - s * reach[1], s * reach[0] + c * reach[1]], axis=1)
    places = np.concatenate([placements[:, :2], ends], axis=1)
    order = np.flatnonzero(np.isfinite(costs))
    if len(order) > _SORTED:
        order = order[np.argpartition(costs[order], _SORTED)[:_SORTED]]
    order = order[np.argsort(costs[order], kind="stable")]
    kept: list[int] = []
    while len(order) and len(kept) < most:
        kept.append(int(order[0]))
        away = places[order] - places[order[0]]
        far = np.maximum(np.hypot(away[:, 0], away[:, 1]), np.hypot(away[:, 2], away[:, 3])) > apart_m
        order = order[far]
    return kept


def turns(problem: MatchProblem) -> Float64Array:
    """Turns of a coarse search, rad, smallest first: so many that the far end is rarely off by more than two cells."""
    region = problem.region
    sd = TURN_SD if region is None else region.heading_sd
    span = float(np.hypot(*(problem.track.xy - problem.track.xy[0]).T).max())
    step = 4.0 * problem.grid_map.cell_m / max(span, 1e-9)
    half = min(int(np.ceil(2.0 * sd / step - 0.5)), (_MOST_ANGLES - 1) // 2) if sd > 0.0 else 0
    if half <= 0:
        return np.zeros(1)
    angles = np.linspace(-2.0 * sd, 2.0 * sd, 2 * half + 1)
    ordered: Float64Array = angles[np.argsort(np.abs(angles), kind="stable")]
    return ordered


def lattice(problem: MatchProblem, step_m: float, sigmas: float = 3.0) -> Float64Array:
    """Shifts of the track on a square lattice about the region's centre, shape (k, 2), m, likeliest beforehand first.

    Without a region the track's first point goes anywhere on the map.
    """
    region, first = problem.region, problem.track.xy[0]
    if region is None:
        x_min, y_min, x_max, y_max = problem.grid_map.extent
        columns, rows = np.arange(x_min, x_max + 1e-9, step_m), np.arange(y_min, y_max + 1e-9, step_m)
        anywhere: Float64Array = np.stack(np.meshgrid(columns, rows), axis=2).reshape(-1, 2) - first
        return anywhere
    steps = [
        step_m * np.arange(-np.floor(half / step_m), np.floor(half / step_m) + 1) for half in region.half_widths(sigmas)
    ]
    away = np.stack(np.meshgrid(*steps), axis=2).reshape(-1, 2)
    nearness = np.einsum("ki,ij,kj->k", away, np.linalg.inv(region.cov), away)
    shifts: Float64Array = away[np.argsort(nearness, kind="stable")] + (region.x, region.y) - first
    return shifts


def level_offset(offset: Float64Array, features: FeatureSet, track: Track, rotation: float) -> Float64Array:
    """An offset of the device (channels,) as it shows at each point of the turned track, shape (n, channels), uT."""
    if features is not FeatureSet.VECTOR:
        return np.broadcast_to(offset, (len(track), len(offset)))
    c, s = np.cos(track.heading + rotation), np.sin(track.heading + rotation)
    return np.stack([c * offset[0] - s * offset[1], s * offset[0] + c * offset[1], np.full(len(c), offset[2])], axis=1)


def sensor_offset(
    problem: MatchProblem, profile: Profile, placement: Float64Array
) -> tuple[Float64Array, Float64Array]:
    """The sensor's offset as a placement has it, uT, device's frame, and its standard deviation; shape (channels,).

    None for a sensor that is calibrated to its noise. A median, because a placement that is not quite right has large
    differences in places.

    Parameters
    ----------
    problem : MatchProblem
    profile : Profile
        In the features that are compared.
    placement : array, shape (4,)
        dx, dy (m), rotation (rad), scale.
    """
    known = np.full(profile.values.shape[1], profile.offset_sd)
    if not uncalibrated(profile):
        return np.zeros(len(known)), known
    x, y = placed(problem.track.xy, *(float(part) for part in placement))
    residual = profile.turned(float(placement[2])).values - read_map(problem.grid_map, profile.features, x, y).mean
    if profile.features is FeatureSet.VECTOR:
        angle = -(problem.track.heading + placement[2])
        c, s = np.cos(angle), np.sin(angle)
        east, north = residual[:, 0], residual[:, 1]
        residual = np.stack([c * east - s * north, s * east + c * north, residual[:, 2]], axis=1)
    offset = np.median(residual, axis=0)
    spread = 1.5 * np.median(np.abs(residual - offset), axis=0)
    return offset, np.minimum(known, np.maximum(spread, profile.noise_sd))
