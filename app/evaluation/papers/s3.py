"""Three-axis voting without odometry and headings corrected by the map, as Bao, Shang and Shi evaluate them.

Bao Jinhong, Shang Junna, Shi Huli, DTW-based declination-corrected geomagnetic matching, Chinese Journal of Sensors and
Actuators, 2019(10). Part 1: a garage lane with a magnetometer alone (10 Hz, map every metre). Part 2: an office of 10 x
5 m, dead reckoning with a compass that steel bends.

Here part 1 runs on the laboratory (recorded, 5 Hz, all legs of its test walks and the corners between them at once) and
on a simulated lane with the paper's map; part 2 on the laboratory's walks and on a simulated office. What the paper
does not say and is chosen here: windows of 8 s, a lane of 60 m (8 uT, 2 m), the office's field (north 20 uT, bent by
14 uT, 2 m: with it dead reckoning errs about as in the paper), ways of eight legs, a start known to 0.3 m.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from app.engine.matching import MatchProblem, Profile, Region, RouteMap, Track, route_along
from app.engine.types import ComplexArray, FeatureSet, Float64Array, GridMap, Progress
from app.evaluation.papers.fields import HarmonicField, map_of, random_field
from app.evaluation.papers.matching import Outcome, Trial, part_of, registered, run_trials
from app.evaluation.papers.walks import WalkReadings, WalkSet, in_features, uji_walks

VOTING, DECLINATION = "voting_dtw", "declination_aided"
WINDOW_S = 8.0
NEAR_M = 1.0
BOUND = 0.977
"""Share of the accepted errors below the bound that S3 gives."""
_SPACING_M = 0.25
_LANE_M, _LANE_SPEED, _LANE_HZ = 60.0, 1.2, 10.0
_OFFICE_M, _OFFICE_LEGS, _OFFICE_HZ, _OFFICE_SPEED = (10.0, 5.0), 8, 10.0, 1.0
_OFFICE_UT = 14.0
_NOISE_UT = 0.5
_PHONE_OFFSET_UT = 5.0
_START_SD_M = 0.3
_TURN_SD, _STRIDE_SD = 0.5, 0.1
_HEADING_BASE_M = 0.5
"""Directions of tracks are taken over twice as much way: single steps jitter."""


@dataclass(frozen=True, slots=True)
class VotingResult:
    """Part 1 on one place: the answers, and how long the routes are together, m."""

    name: str
    outcomes: tuple[Outcome, ...]
    routes_m: float


@dataclass(frozen=True, slots=True)
class DeclinationResult:
    """Part 2 on one place: the trials and the answers to them."""

    name: str
    trials: tuple[Trial, ...]
    outcomes: tuple[Outcome, ...]


def run_s3(
    data: Path, *, tracks: int, jobs: int = 1, cache: Path | None = None, progress: Progress | None = None
) -> tuple[tuple[VotingResult, ...], tuple[DeclinationResult, ...], tuple[str, ...]]:
    """Both parts; also notes about what was left out."""
    say = progress or (lambda _fraction, _what: None)
    methods, notes = registered((VOTING, DECLINATION))
    voting: list[VotingResult] = []
    aided: list[DeclinationResult] = []
    if not methods:
        return (), (), notes
    say(0.0, "map of the laboratory")
    uji = uji_walks(data, cache)
    if VOTING in methods:
        for number, (name, trials) in enumerate((("uji", corridor_trials(uji, tracks)), ("lane", lane_trials(tracks)))):
            part = part_of(say, 0.1 + 0.2 * number, 0.2, name)
            outcomes = run_trials((VOTING,), trials, jobs=jobs, progress=part)[VOTING]
            voting.append(VotingResult(name, outcomes, _routes_m(trials)))
    if DECLINATION in methods:
        for number, (name, trials) in enumerate((("uji", walk_trials(uji)), ("office", office_trials(tracks)))):
            part = part_of(say, 0.5 + 0.25 * number, 0.25, name)
            outcomes = run_trials((DECLINATION,), trials, jobs=jobs, progress=part)[DECLINATION]
            aided.append(DeclinationResult(name, trials, outcomes))
    return tuple(voting), tuple(aided), notes


def _routes_m(trials: tuple[Trial, ...]) -> float:
    routes = trials[0].problem.routes if trials else ()
    return float(sum((len(route) - 1) * route.spacing_m for route in routes))


# Part 1: no odometry. The track says how much time passed, at a walker's usual speed; its way is good for nothing else.


def corridor_trials(uji: WalkSet, count: int) -> tuple[Trial, ...]:
    """Windows of the laboratory's test walks, sought along the legs and corners of all of them."""
    routes = _routes(uji.grid_map, [walk.corners for walk in uji.walks], _SPACING_M)
    window = round(WINDOW_S * uji.rate_hz)
    starts = [(walk, start) for walk in uji.walks for start in range(0, len(walk) - window, window // 4)]
    chosen = np.linspace(0, len(starts) - 1, min(count, len(starts))).round().astype(np.int64).tolist()
    trials = []
    for number, (walk, start) in enumerate(starts[i] for i in dict.fromkeys(chosen)):
        rows = slice(start, start + window)
        values = in_features(walk.mag[rows], walk.heading[rows], FeatureSet.VECTOR)
        profile = Profile(FeatureSet.VECTOR, values, np.full(3, _NOISE_UT), _PHONE_OFFSET_UT)
        track = _paced(walk.t[rows], walk.heading[rows], 1.0)
        problem = MatchProblem(profile, track, uji.grid_map, routes=routes, seed=number)
        trials.append(Trial(f"{walk.walk_id}/{start}", problem, walk.x[rows], walk.y[rows]))
    return tuple(trials)


def _routes(grid_map: GridMap, ways: list[Float64Array], spacing_m: float) -> tuple[RouteMap, ...]:
    """Each leg and each pair of legs of some ways, once, whatever their direction."""
    lines: dict[tuple[tuple[float, ...], ...], Float64Array] = {}
    for way in ways:
        for size in (2, 3):
            for first in range(len(way) - size + 1):
                line = way[first : first + size]
                key = tuple(tuple(np.round(point, 1).tolist()) for point in line)
                if key[::-1] not in lines:
                    lines[key] = line
    found = (route_along(grid_map, line, spacing_m) for line in lines.values())
    return tuple(route for route in found if route is not None)


def lane_trials(count: int) -> tuple[Trial, ...]:
    """Windows of passes along a garage lane, mapped every metre from fifty readings a point."""
    rng = np.random.default_rng(31)
    field = random_field(rng, spread_ut=8.0, length_m=2.0, mean=(0.0, 30.0, -40.0))
    grid_map = map_of(field, _LANE_M, 2.0, cell_m=1.0, sd_ut=_NOISE_UT / np.sqrt(50.0), rng=rng)
    lane = route_along(grid_map, np.array([[0.0, 1.0], [_LANE_M, 1.0]]), 0.5)
    assert lane is not None  # noqa: S101 - sixty metres
    return tuple(_lane_trial(grid_map, field, lane, number) for number in range(count))


def _lane_trial(grid_map: GridMap, field: HarmonicField, lane: RouteMap, seed: int) -> Trial:
    rng = np.random.default_rng(3100 + seed)
    t = np.arange(0.0, WINDOW_S, 1.0 / _LANE_HZ)
    speed = _LANE_SPEED * (1.0 + 0.15 * np.sin(0.9 * t + rng.uniform(0.0, 2.0 * np.pi)))
    way = np.concatenate([[0.0], np.cumsum(speed[1:] / _LANE_HZ)])
    x = rng.uniform(0.0, _LANE_M - way[-1]) + way
    heading = np.zeros(len(t))
    if rng.random() < 0.5:
        x, heading = x[::-1], np.full(len(t), np.pi)
    y = np.full(len(t), 1.0)
    values = field.at(x, y) + _NOISE_UT * rng.standard_normal((len(t), 3))
    profile = Profile(FeatureSet.VECTOR, values, np.full(3, _NOISE_UT))
    problem = MatchProblem(profile, _paced(t, heading, _LANE_SPEED), grid_map, routes=(lane,), seed=seed)
    return Trial(f"lane/{seed}", problem, x, y)


def _paced(t: Float64Array, heading: Float64Array, speed: float) -> Track:
    way = speed * (t - t[0])
    step = np.diff(way, prepend=0.0)
    cov = (0.3 * way)[:, None, None] ** 2 * np.eye(2)
    return Track(t, np.cumsum(step * np.cos(heading)), np.cumsum(step * np.sin(heading)), heading, cov)


# Part 2: step lengths and a compass. Vectors of the profile are as the compass' headings have them.


def walk_trials(uji: WalkSet) -> tuple[Trial, ...]:
    """The laboratory's test walks from their first label on."""
    trials = []
    for number, walk in enumerate(uji.walks):
        route = route_along(uji.grid_map, walk.corners, _SPACING_M)
        routes = () if route is None else (route,)
        heading = compass_headings(walk.mag, uji.grid_map)
        trials.append(_aided_trial(uji.grid_map, walk, heading, routes, _PHONE_OFFSET_UT, seed=number))
    return tuple(trials)


def compass_headings(mag: Float64Array, grid_map: GridMap) -> Float64Array:
    """Headings of the device, rad, by the horizontal field (forward, left, up), taken for the map's mean one."""
    mapped = grid_map.mapped
    mean_x, mean_y = (float(grid_map.mean[axis][mapped].mean()) for axis in (0, 1))
    north = np.arctan2(mean_y, mean_x)
    return np.asarray(np.unwrap(north - np.arctan2(mag[:, 1], mag[:, 0])), dtype=np.float64)


def office_trials(count: int) -> tuple[Trial, ...]:
    """Ways about an office whose steel bends the compass."""
    rng = np.random.default_rng(32)
    field = random_field(rng, spread_ut=_OFFICE_UT, length_m=2.0, mean=(0.0, 20.0, -40.0))
    grid_map = map_of(field, *_OFFICE_M, cell_m=0.25, sd_ut=0.3, rng=rng)
    return tuple(_office_trial(grid_map, field, number) for number in range(count))


def _office_trial(grid_map: GridMap, field: HarmonicField, seed: int) -> Trial:
    rng = np.random.default_rng(3200 + seed)
    corners = _corners(rng)
    legs = np.hypot(*np.diff(corners, axis=0).T)
    along = np.concatenate([[0.0], np.cumsum(legs)])
    t = np.arange(0.0, along[-1] / _OFFICE_SPEED, 1.0 / _OFFICE_HZ)
    x, y = (np.interp(_OFFICE_SPEED * t, along, corners[:, k]) for k in range(2))
    leg = np.clip(np.searchsorted(along, _OFFICE_SPEED * t, side="right") - 1, 0, len(legs) - 1)
    course = np.arctan2(*np.diff(corners, axis=0).T[::-1])[leg]
    level = field.at(x, y) + _NOISE_UT * rng.standard_normal((len(t), 3))
    c, s = np.cos(course), np.sin(course)
    mag = np.stack([c * level[:, 0] + s * level[:, 1], c * level[:, 1] - s * level[:, 0], level[:, 2]], axis=1)
    way = _OFFICE_SPEED * t * (1.0 + _STRIDE_SD * rng.standard_normal() / 2.0)
    walk = WalkReadings(f"office/{seed}", t, x, y, course, mag, course, way, corners)
    route = route_along(grid_map, corners, _SPACING_M)
    routes = () if route is None else (route,)
    return _aided_trial(grid_map, walk, compass_headings(mag, grid_map), routes, 0.0, seed=seed)


def _corners(rng: np.random.Generator) -> Float64Array:
    """Corners of a way inside the office, none of its legs shorter than 2 m."""
    width, height = _OFFICE_M
    corners = [np.array([rng.uniform(0.0, width), rng.uniform(0.0, height)])]
    while len(corners) <= _OFFICE_LEGS:
        there = np.array([rng.uniform(0.0, width), rng.uniform(0.0, height)])
        if np.hypot(*(there - corners[-1])) >= 2.0:
            corners.append(there)
    return np.array(corners)


def _aided_trial(
    grid_map: GridMap, walk: WalkReadings, heading: Float64Array, routes: tuple[RouteMap, ...], offset_sd: float, *,
    seed: int,
) -> Trial:  # fmt: skip
    rng = np.random.default_rng(3300 + seed)
    start = np.array([walk.x[0], walk.y[0]]) + _START_SD_M * rng.standard_normal(2)
    x, y = walk.dead_reckoned(heading)
    way = walk.way - walk.way[0]
    cov = ((_TURN_SD**2 + _STRIDE_SD**2) / 2.0 * way**2)[:, None, None] * np.eye(2)
    track = Track(walk.t, start[0] + x, start[1] + y, heading, cov)
    values = in_features(walk.mag, heading, FeatureSet.VECTOR)
    profile = Profile(FeatureSet.VECTOR, values, np.full(3, _NOISE_UT), offset_sd)
    region = Region(float(start[0]), float(start[1]), np.eye(2) * _START_SD_M**2, _TURN_SD, _STRIDE_SD)
    problem = MatchProblem(profile, track, grid_map, region, routes=routes, seed=seed)
    return Trial(walk.walk_id, problem, walk.x, walk.y)


def heading_errors(trial: Trial, x: Float64Array, y: Float64Array) -> Float64Array:
    """Direction of a track less that of the true way, absolute, shape (m,), rad, where the true way runs straight.

    At a corner, who turns a step too early or too late is wrong by the whole corner.
    """
    true_way = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(trial.x), np.diff(trial.y)))])
    rows = np.flatnonzero(np.concatenate([[True], np.diff(true_way) > 1e-9]))
    s = true_way[rows]
    back, ahead = np.maximum(s - _HEADING_BASE_M, 0.0), np.minimum(s + _HEADING_BASE_M, s[-1])

    def leap(px: Float64Array, py: Float64Array) -> ComplexArray:
        z = px[rows] + 1j * py[rows]
        return np.asarray(np.interp(ahead, s, z) - np.interp(back, s, z), dtype=np.complex128)

    true, own = leap(trial.x, trial.y), leap(x, y)
    straight = np.abs(true) > 0.99 * (ahead - back)
    return np.asarray(np.abs(np.angle(own * np.conj(true)))[straight], dtype=np.float64)


def indicated_errors(trial: Trial) -> Float64Array:
    """Distance of the dead-reckoned track from the truth, shape (n,), m."""
    track = trial.problem.track
    return np.hypot(track.x - trial.x, track.y - trial.y)
