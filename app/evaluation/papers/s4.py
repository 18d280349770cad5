"""Contour matching over an area, as Cheng and Zhou evaluate it, on recorded anomalies.

Cheng Yonghang, Zhou Yong, Improved geomagnetic matching based on contour matching, Ordnance Industry Automation,
2026(5), doi:10.7690/bgzdh.2026.05.004: an inertial navigation system drifts, a total-field sensor reads every 20 s,
the indicated start is off by up to 4 km, the map has 200 m cells. They simulate tracks on two kriged maps, one marine
and one on land.

Here the maps are kriged of flight lines (Rio de Janeiro, Great Britain). ``marine`` is the smoothest 28 km square of
them all, ``land`` the roughest. Two kinds of tracks: ``simulated`` on the map, which is then the very field (as in the
paper), and ``lines``, recorded along flight lines that no map has seen, where the map is as wrong as maps are.

What the paper does not say and is chosen here: 10 m/s, 61 readings (20 min, 12 km), a simulated track bends once, by up
to 60 degrees, inside its middle third.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from app.engine.matching import MatchProblem, Profile, Region, Track, read_map
from app.engine.types import FeatureSet, Float64Array, GridMap, Progress
from app.evaluation.datasets.aero import open_aero
from app.evaluation.errors import DataSetError
from app.evaluation.papers.anomalies import (
    UT_PER_NT,
    AnomalySettings,
    Extent,
    PlacedSegment,
    Window,
    cached_map,
    inset,
    map_path,
    overview_map,
    place_survey,
    stretches,
    window_map,
    windows_of,
)
from app.evaluation.papers.ins import InertialErrors, simulate_drift
from app.evaluation.papers.matching import Outcome, Trial, part_of, run_trials, suited

INS = InertialErrors(gyro_drift_deg_h=0.005, accelerometer_bias=5e-4, heading=4e-4)
"""S4's errors; the heading error at the start is what this drift leaves a gyrocompass with at middle latitudes."""
NOISE_NT = 1.0
START_M = 4000.0
EVERY_S = 20
SPEED_M_S = 10.0
READINGS = 61
FAILED_M = 1000.0
"""A track whose end is farther off than this has been put in a wrong place."""
_MAP_SD_NT = 0.1
"""Of a map that is the very field: rounding."""
_BEND = np.radians(60.0)
_TRIES = 200


@dataclass(frozen=True, slots=True)
class Ground:
    """A window with its map and where its recorded tracks may run.

    Attributes
    ----------
    kind : str
        ``marine`` or ``land``.
    window : Window
    grid_map : GridMap
    stretches : tuple of PlacedSegment
        Parts of left-out lines.
    """

    kind: str
    window: Window
    grid_map: GridMap
    stretches: tuple[PlacedSegment, ...]


@dataclass(frozen=True, slots=True)
class RegionResult:
    """Answers over one region and one kind of track.

    Attributes
    ----------
    name : str
        ``marine``, ``land``, ``marine_lines`` or ``land_lines``.
    ground : Ground
    trials : tuple of Trial
    outcomes : mapping of method to tuple of Outcome
    n_lines : int
        Left-out lines that the tracks run along; 0 for simulated tracks.
    """

    name: str
    ground: Ground
    trials: tuple[Trial, ...]
    outcomes: dict[str, tuple[Outcome, ...]]
    n_lines: int = 0


def choose_grounds(
    data: Path, settings: AnomalySettings, cache: Path | None = None, progress: Progress | None = None
) -> tuple[Ground, ...]:
    """The smoothest and the roughest window of all surveys, by the root mean square of the field's gradient.

    Raises
    ------
    DataSetError
        No surveys, or fewer than two windows.
    """
    say = progress or (lambda _fraction, _what: None)
    aero = open_aero(data)
    length = way_m()
    windows = []
    for number, name in enumerate(aero.surveys()):
        say(0.6 * number / len(aero.surveys()), f"map of {name}")
        survey = aero.survey(name)
        placed = place_survey(survey, settings)
        path = map_path(cache, survey, settings, None)
        overview = cached_map(path, partial(overview_map, placed, settings))
        windows += windows_of(placed, overview, settings, length)
    if len(windows) < 2:
        raise DataSetError(aero.folder, f"holds {len(windows)} mapped windows with a left-out line; two are needed")
    windows.sort(key=lambda window: window.gradient_nt_km)
    grounds = []
    for kind, window in (("marine", windows[0]), ("land", windows[-1])):
        say(0.8, f"map of the {kind} region")
        path = map_path(cache, aero.survey(window.survey.name), settings, window.extent)
        grid_map = cached_map(path, partial(window_map, window.survey, window.extent, settings))
        parts = stretches(window.survey.left_out, inset(window.extent, settings), length)
        grounds.append(Ground(kind, window, grid_map, tuple(parts)))
    return tuple(grounds)


def way_m() -> float:
    """Length of a track, m."""
    return SPEED_M_S * EVERY_S * (READINGS - 1)


def run_s4(
    data: Path,
    settings: AnomalySettings,
    *,
    tracks: int,
    jobs: int = 1,
    cache: Path | None = None,
    progress: Progress | None = None,
) -> tuple[RegionResult, ...]:
    """Put every method that suits an area and the total field to the test."""
    say = progress or (lambda _fraction, _what: None)
    grounds = choose_grounds(data, settings, cache, lambda f, what: say(0.1 * f, what))
    methods = suited("area", FeatureSet.TOTAL)
    results = []
    for number, (ground, recorded) in enumerate((g, r) for r in (False, True) for g in grounds):
        rng = np.random.default_rng(4 + number)
        name = f"{ground.kind}_lines" if recorded else ground.kind
        trials = draw_trials(ground, tracks, rng, settings, recorded=recorded)
        outcomes = run_trials(methods, trials, jobs=jobs, progress=part_of(say, 0.1 + 0.225 * number, 0.225, name))
        n_lines = len({part.line for part in ground.stretches}) if recorded else 0
        results.append(RegionResult(name, ground, trials, outcomes, n_lines))
    return tuple(results)


def draw_trials(
    ground: Ground, count: int, rng: np.random.Generator, settings: AnomalySettings, *, recorded: bool
) -> tuple[Trial, ...]:
    """Draw tracks, what the sensor reads along them, and what an inertial navigation system makes of them."""
    grid_map = ground.grid_map if recorded else _as_the_field(ground.grid_map)
    area = inset(ground.window.extent, settings)
    trials = []
    for number in range(count):
        if recorded:
            x, y, values = _along_a_line(ground.stretches, rng)
        else:
            x, y = _bent_way(area, rng)
            values = read_map(grid_map, FeatureSet.TOTAL, x, y).mean[:, 0]
        trials.append(_trial(f"{number}", grid_map, x, y, values, rng, seed=number))
    return tuple(trials)


def _as_the_field(grid_map: GridMap) -> GridMap:
    """The map as the truth: no deviation but rounding."""
    return replace(
        grid_map, sd=np.full_like(grid_map.sd, UT_PER_NT * _MAP_SD_NT), noise_sd=(0.0,),
        support=np.zeros_like(grid_map.support),
    )  # fmt: skip


def _trial(
    name: str, grid_map: GridMap, x: Float64Array, y: Float64Array, values: Float64Array, rng: np.random.Generator,
    *, seed: int,
) -> Trial:  # fmt: skip
    noise = UT_PER_NT * NOISE_NT
    readings = values + noise * rng.standard_normal(len(values))
    track = indicated_track(x, y, rng)
    radius, angle = START_M * np.sqrt(rng.random()), 2.0 * np.pi * rng.random()
    shift_x, shift_y = radius * np.cos(angle), radius * np.sin(angle)
    track = replace(track, x=track.x + shift_x, y=track.y + shift_y)
    region = Region(
        float(track.x[0]), float(track.y[0]), np.eye(2) * (START_M / 2.0) ** 2,
        heading_sd=float(np.hypot(INS.heading, 1e-3)), scale_sd=1e-3,
    )  # fmt: skip
    profile = Profile(FeatureSet.TOTAL, readings[:, None], np.array([noise]))
    return Trial(name, MatchProblem(profile, track, grid_map, region, seed=seed), x, y)


def indicated_track(x: Float64Array, y: Float64Array, rng: np.random.Generator) -> Track:
    """What the inertial navigation system indicates when started in the right place: integrated at 1 Hz."""
    t = EVERY_S * np.arange(len(x), dtype=np.float64)
    fine = np.arange(0.0, t[-1] + 0.5)
    fx, fy = np.interp(fine, t, x), np.interp(fine, t, y)
    vx, vy = np.gradient(fx, fine), np.gradient(fy, fine)
    course = np.unwrap(np.arctan2(vy, vx))
    drift = simulate_drift(INS, fine, course, np.hypot(vx, vy), rng)
    at = np.arange(0, len(fine), EVERY_S)
    return Track(t, x + drift.xy[at, 0], y + drift.xy[at, 1], course[at] + drift.heading[at], drift.cov[at])


def _bent_way(area: Extent, rng: np.random.Generator) -> tuple[Float64Array, Float64Array]:
    """A way of two straight legs inside an area."""
    step = SPEED_M_S * EVERY_S
    for _ in range(_TRIES):
        course, bend = rng.uniform(-np.pi, np.pi), rng.uniform(-_BEND, _BEND)
        turn_at = rng.integers(READINGS // 3, 2 * READINGS // 3)
        heading = course + bend * (np.arange(1, READINGS) > turn_at)
        x = rng.uniform(area[0], area[2]) + np.concatenate([[0.0], np.cumsum(step * np.cos(heading))])
        y = rng.uniform(area[1], area[3]) + np.concatenate([[0.0], np.cumsum(step * np.sin(heading))])
        if area[0] <= x.min() and x.max() <= area[2] and area[1] <= y.min() and y.max() <= area[3]:
            return x, y
    raise ValueError(f"no way of {way_m():.0f} m fits into {area}")


def _along_a_line(
    parts: Sequence[PlacedSegment], rng: np.random.Generator
) -> tuple[Float64Array, Float64Array, Float64Array]:
    """Part of a left-out line, either way: positions, m, and recorded values between its readings, uT."""
    part = parts[int(rng.integers(len(parts)))]
    way = part.way
    s = rng.uniform(0.0, way[-1] - way_m()) + SPEED_M_S * EVERY_S * np.arange(READINGS)
    s = s[::-1] if rng.random() < 0.5 else s
    x, y, values = (np.interp(s, way, column) for column in (*part.xy.T, part.values))
    return x, y, values
