"""Sequences slid along a stored one, as Zhang evaluates them, on recorded walks and on a simulated cart.

Zhang Dongli, Passive integrated navigation based on improved DTW geomagnetic matching, MSc thesis, Hangzhou Dianzi
University, 2021: a cart passes a way outdoors twice; a window of 20, 40 or 60 total-field readings of the second pass
is slid along the sequence of the first (530 readings, 20 Hz), with four variants of dynamic time warping.

Here the stored sequence is the map read along the labelled way of the walk: the laboratory (5 Hz, as its phone renews
the field), the hall (20 Hz), and a cart simulated with the thesis' table 3.1. What the thesis does not say and is
chosen here: the field of the cart's yard (6 uT, 1 m: with it plain DTW errs about as in the thesis), its speed on the
second pass (1 m/s, changing by a tenth), that its field noise of 1.4076 is in uT, and that a window's indicated way
begins with the table's initial errors, as if the fix before had set the navigation right but for these.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from app.engine.matching import MatchProblem, Profile, RouteMap, Track, route_along
from app.engine.types import FeatureSet, Float64Array, GridMap, Progress
from app.evaluation.papers.fields import map_of, random_field
from app.evaluation.papers.ins import GRAVITY, InertialErrors, simulate_drift
from app.evaluation.papers.matching import Outcome, Trial, part_of, registered, run_trials
from app.evaluation.papers.walks import WalkReadings, WalkSet, in_features, kaist_walks, total_map, uji_walks

METHODS = ("dtw", "improved_dtw", "ddtw", "ddtw_itakura")
WINDOWS = (20, 40, 60)
CART_HZ, CART_READINGS, CART_SPEED = 20.0, 530, 1.0
CART_NOISE_UT = 1.4076
CART_INS = InertialErrors(
    gyro_drift_deg_h=0.03, gyro_noise_deg_h=0.005, accelerometer_bias=0.001 * GRAVITY,
    accelerometer_noise=0.0005 * GRAVITY, velocity=0.1, tilt=np.radians(1.0), heading=np.radians(1.0),
)  # fmt: skip
"""S1, table 3.1."""
_SPACING_M = 0.1
"""Of stored sequences: S1's map step of 1e-6 degrees."""
_YARD_UT, _YARD_M = 6.0, 1.0
_PHONE_OFFSET_UT, _PHONE_NOISE_UT = 5.0, 0.5
_STRIDE_SD, _TURN_SD = 0.1, 0.1


@dataclass(frozen=True, slots=True)
class WindowResult:
    """Answers over one data set with windows of one length.

    Attributes
    ----------
    name : str
    window : int
        Readings.
    length_m : float, m
        Mean way within a window.
    route_m : float, m
        Mean length of the stored sequences.
    outcomes : mapping of method to tuple of Outcome
    """

    name: str
    window: int
    length_m: float
    route_m: float
    outcomes: dict[str, tuple[Outcome, ...]]


def run_s1(
    data: Path, *, tracks: int, jobs: int = 1, cache: Path | None = None, progress: Progress | None = None
) -> tuple[tuple[WindowResult, ...], tuple[str, ...]]:
    """Slide windows of the three lengths along the stored sequences; also notes about what was left out."""
    say = progress or (lambda _fraction, _what: None)
    methods, notes = registered(METHODS)
    if not methods:
        return (), notes
    say(0.0, "maps")
    recordings = (uji_walks(data, cache), kaist_walks(data, cache))
    sets = tuple(replace(one, grid_map=total_map(one.grid_map)) for one in recordings)
    results = []
    runs = [(name, window) for name in (*(one.name for one in sets), "cart") for window in WINDOWS]
    for number, (name, window) in enumerate(runs):
        recorded = next((one for one in sets if one.name == name), None)
        trials = cart_trials(window, tracks) if recorded is None else window_trials(recorded, window, tracks)
        share = 0.9 / len(runs)
        part = part_of(say, 0.1 + share * number, share, f"{name}, window {window}")
        outcomes = run_trials(methods, trials, jobs=jobs, progress=part)
        results.append(_result(name, window, trials, outcomes))
    return tuple(results), notes


def _result(
    name: str, window: int, trials: tuple[Trial, ...], outcomes: dict[str, tuple[Outcome, ...]]
) -> WindowResult:
    lengths = [float(np.hypot(np.diff(trial.x), np.diff(trial.y)).sum()) for trial in trials]
    routes = [(len(trial.problem.routes[0]) - 1) * trial.problem.routes[0].spacing_m for trial in trials]
    return WindowResult(name, window, float(np.mean(lengths or [0.0])), float(np.mean(routes or [0.0])), outcomes)


def window_trials(recorded: WalkSet, window: int, count: int) -> tuple[Trial, ...]:
    """Windows spread evenly over all walks of a set with a total-field map; each is sought along its own walk's way."""
    starts = [(walk, start) for walk in recorded.walks for start in range(0, len(walk) - window, max(window // 4, 1))]
    chosen = np.linspace(0, len(starts) - 1, min(count, len(starts))).round().astype(np.int64).tolist()
    routes: dict[str, RouteMap] = {}
    trials = []
    for number, (walk, start) in enumerate(starts[i] for i in dict.fromkeys(chosen)):
        if walk.walk_id not in routes:
            route = route_along(recorded.grid_map, walk.corners, _SPACING_M)
            if route is None:
                continue
            routes[walk.walk_id] = route
        trials.append(_window_trial(recorded.grid_map, walk, start, window, routes[walk.walk_id], seed=number))
    return tuple(trials)


def _window_trial(
    grid_map: GridMap, walk: WalkReadings, start: int, window: int, route: RouteMap, *, seed: int
) -> Trial:
    rows = slice(start, start + window)
    heading = walk.heading[rows]
    x, y = walk.dead_reckoned(walk.heading)
    way = walk.way[rows] - walk.way[start]
    cov = ((_STRIDE_SD**2 + _TURN_SD**2) / 2.0 * way**2)[:, None, None] * np.eye(2)
    track = Track(walk.t[rows], x[rows] - x[start], y[rows] - y[start], heading, cov)
    values = in_features(walk.mag[rows], heading, FeatureSet.TOTAL)
    profile = Profile(FeatureSet.TOTAL, values, np.array([_PHONE_NOISE_UT]), _PHONE_OFFSET_UT)
    problem = MatchProblem(profile, track, grid_map, routes=(route,), seed=seed)
    return Trial(f"{walk.walk_id}/{start}", problem, walk.x[rows], walk.y[rows])


def cart_trials(window: int, count: int) -> tuple[Trial, ...]:
    """Second passes of a cart over a bent way, each with its own field and inertial errors."""
    return tuple(_cart_trial(window, number) for number in range(count))


def _cart_trial(window: int, seed: int) -> Trial:
    rng = np.random.default_rng(1000 + seed)
    way = CART_SPEED / CART_HZ * np.arange(CART_READINGS)
    heading = rng.uniform(-np.pi, np.pi) + 0.8 * np.sin(way / way[-1] * 2.0 * np.pi)
    x, y = (np.cumsum(CART_SPEED / CART_HZ * part(heading)) for part in (np.cos, np.sin))
    x, y = x - x.min(), y - y.min()
    field = random_field(rng, spread_ut=_YARD_UT, length_m=_YARD_M, mean=(0.0, 30.0, -40.0))
    grid_map = map_of(field, float(x.max()), float(y.max()), cell_m=0.25, sd_ut=0.1, rng=rng, features=FeatureSet.TOTAL)
    route = route_along(grid_map, np.stack([x, y], axis=1), _SPACING_M)
    assert route is not None  # noqa: S101 - the way is 26 m long
    t = np.arange(CART_READINGS) / CART_HZ
    driven = np.interp(t, t, way) + 0.1 / 0.7 * np.sin(0.7 * t + rng.uniform(0.0, 6.0))
    driven = np.clip(driven - driven[0], 0.0, way[-1])
    true_x, true_y, course = (np.interp(driven, way, part) for part in (x, y, heading))
    start = int(rng.integers(0, CART_READINGS - window))
    rows = slice(start, start + window)
    t, course, true_x, true_y = t[rows], course[rows], true_x[rows], true_y[rows]
    drift = simulate_drift(CART_INS, t, course, np.gradient(driven, 1.0 / CART_HZ)[rows], rng)
    at = np.linalg.norm(field.at(true_x, true_y), axis=1)[:, None]
    values = at + CART_NOISE_UT * rng.standard_normal(at.shape)
    x, y = true_x - true_x[0] + drift.xy[:, 0], true_y - true_y[0] + drift.xy[:, 1]
    track = Track(t, x, y, course + drift.heading, drift.cov)
    profile = Profile(FeatureSet.TOTAL, values, np.array([CART_NOISE_UT]))
    problem = MatchProblem(profile, track, grid_map, routes=(route,), seed=seed)
    return Trial(f"cart/{seed}", problem, true_x, true_y)


def end_errors(outcomes: tuple[Outcome, ...]) -> Float64Array:
    """Errors of the window's end, m; infinite without a place."""
    return np.array([outcome.error for outcome in outcomes])
