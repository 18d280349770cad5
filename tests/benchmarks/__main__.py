"""Kernels and map building, timed: ``python -m tests.benchmarks --out DIR``.

CPU seconds of one thread, median of several rounds after a warm-up. The figures in docs/benchmarks.md come from here.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from app.engine.filtering import Cloud, FilterGrid, ParticleNoise, advance_cloud, prepare_grid
from app.engine.inertial import StepEvents, advance
from app.engine.localization.aids import Evaluator, RadioSighting
from app.engine.localization.initial import InitialSpread
from app.engine.localization.lost import Check
from app.engine.localization.particle import ParticleParameters, ParticleTracker
from app.engine.localization.profile import newest
from app.engine.localization.radio import RadioScan
from app.engine.localization.search import SearchPolicy, search
from app.engine.localization.session import SessionState
from app.engine.mapping import Covariance, FieldLevel, FieldSamples, krige_grid
from app.engine.types import FeatureSet, Prior, RadioMap, Segment, TrackerState
from tests.engine.conftest import CORNERS, LevelMaps, OneMap
from tests.support.walks import Field, cut, true_map, walk_through

ROUNDS = 9


def median_cpu(task: Callable[[], object], *, repeat: int = 1, rounds: int = ROUNDS) -> float:
    """Median CPU seconds of one call."""
    task()
    times = []
    for _ in range(rounds):
        began = time.process_time()
        for _ in range(repeat):
            task()
        times.append((time.process_time() - began) / repeat)
    return float(np.median(times))


def particle_step(features: FeatureSet, n: int) -> float:
    """Microseconds of one fused step on a 400 x 400 map."""
    rng = np.random.default_rng(0)
    nodes = rng.standard_normal((400, 400, 7)).astype(np.float32)
    nodes[..., 3:5] = 1.0
    nodes[..., 6] = 1.0
    grid = FilterGrid(features, 0.0, 0.0, 0.5, nodes, (3.0, 3.0))
    cloud = Cloud.empty(n)
    cloud.p[0], cloud.p[1] = rng.uniform(90, 110, (2, n))
    cloud.p[12:14] = 10.0
    holder = [cloud]

    def step() -> None:
        z = np.array([1.0, 0.5, -0.5])
        holder[0] = advance_cloud(
            holder[0], grid, ParticleNoise(), turn_mid=0.01, turn=0.02, stride=0.05, z=z, rng=rng
        ).cloud

    return 1e6 * median_cpu(step, repeat=300)


def map_build(*, curl_free: bool = False) -> float:
    """Seconds for 20,000 three-component samples onto 400 x 400 nodes with standard deviation."""
    rng = np.random.default_rng(0)
    a = rng.uniform(0, 100, 20_000)
    xy = np.stack([a, 2.0 * rng.integers(0, 50, 20_000) + 0.1 * rng.standard_normal(20_000)], axis=1)
    samples = FieldSamples(xy, rng.integers(0, 80, 20_000), rng.standard_normal((20_000, 3)))
    level, axis = FieldLevel(np.zeros(3), np.ones(3)), 0.25 * np.arange(400)
    covariance = Covariance(curl_free=curl_free)
    return median_cpu(lambda: krige_grid(samples, level, covariance, axis, axis), rounds=3)


def segment() -> dict[str, float]:
    """Milliseconds of a 5-s segment: motion alone, the whole tracker, and a check of the track."""
    field = Field.random(np.random.default_rng(1))
    walk = walk_through(CORNERS, field, np.random.default_rng(2))
    source = OneMap(true_map(field, (0.0, 0.0, 42.0, 22.0)))
    pieces = cut(walk.samples, seconds=5.0)
    tracker = ParticleTracker()
    state = tracker.start(Prior("sim", 2.0, 2.0), seed=1)
    for piece in pieces[:5]:  # by then the prior has been checked
        state, _ = tracker.step(state, Segment(piece), source)
    before, _ = advance(None, pieces[0])
    return {
        "motion_ms": 1e3 * median_cpu(lambda: advance(before, pieces[1]), repeat=20),
        "segment_ms": 1e3 * median_cpu(lambda: tracker.step(state, Segment(pieces[5]), source), repeat=20),
        "check_ms": 1e3 * median_cpu(lambda: _check(tracker, state, source)),
    }


def _check(tracker: ParticleTracker, state: TrackerState, source: OneMap) -> None:
    """Weigh a track's newest steps against all other places of a level of 42 m x 22 m."""
    track = SessionState.decode(state.payload).track
    if track is not None:
        grids = {"sim": prepare_grid(source.grid_map("sim"), FeatureSet.VECTOR)}
        check = Check(grids, (), tracker.spread, tracker.search, tracker.lost)
        check.log_odds(track, None, np.random.default_rng(0))


def level_search(levels: int) -> float:
    """Milliseconds to search a walk of 60 steps on levels of 100 m x 60 m."""
    field = Field.random(np.random.default_rng(1))
    walk = walk_through(np.array([[5.0, 5.0], [40.0, 5.0], [40.0, 30.0]]), field, np.random.default_rng(2))
    _, events = advance(None, walk.samples)
    source = LevelMaps({str(k): true_map(field, (0.0, 0.0, 100.0, 60.0), level_id=str(k)) for k in range(levels)})
    return 1e3 * median_cpu(lambda: _search(newest(events, 60), source, ()), rounds=5)


def radio_search(levels: int) -> tuple[float, float]:
    """The same with a scan of 150 transmitters after every third step, on radio layers of 1,600 over 60 x 60 nodes.

    First as a worker does that has seen the session's scans before, then as one that has not.
    """
    field, rng = Field.random(np.random.default_rng(1)), np.random.default_rng(4)
    walk = walk_through(np.array([[5.0, 5.0], [40.0, 5.0], [40.0, 30.0]]), field, np.random.default_rng(2))
    events = newest(advance(None, walk.samples)[1], 60)
    names = tuple(f"{k:012x}" for k in range(1600))
    maps = {str(k): true_map(field, (0.0, 0.0, 100.0, 60.0), level_id=str(k)) for k in range(levels)}
    source = LevelMaps({level_id: replace(one, radio=_layer(names, rng)) for level_id, one in maps.items()})

    def heard() -> list[RadioSighting]:
        """Scans that nobody has seen before."""
        return [RadioSighting(_scan(names, float(t), rng), 2.1 * k) for k, t in enumerate(events.t[1::3])]

    seen = heard()
    again = median_cpu(lambda: _search(events, source, seen), rounds=5)
    first = median_cpu(lambda: _search(events, source, heard()), rounds=5)
    return 1e3 * again, 1e3 * first


def _scan(names: tuple[str, ...], t: float, rng: np.random.Generator) -> RadioScan:
    heard = tuple(names[i] for i in rng.choice(len(names), 150, replace=False))
    return RadioScan(t, t, heard, rng.uniform(-95.0, -45.0, 150))


def _layer(names: tuple[str, ...], rng: np.random.Generator) -> RadioMap:
    shape = (len(names), 60, 60)
    mean = rng.integers(-95, -45, shape).astype(np.int8)
    sd, seen = (rng.integers(30, 120, shape).astype(np.uint8) for _ in range(2))
    return RadioMap(-40.0, -60.0, 3.0, names, mean, sd, seen)


def _search(events: StepEvents, source: LevelMaps, seen: Sequence[RadioSighting]) -> None:
    evaluator = Evaluator(source, source.level_ids())
    pieces = [evaluator.evidence(sighting) for sighting in seen]
    search(
        events,
        {level_id: prepare_grid(source.grid_map(level_id), FeatureSet.VECTOR) for level_id in source.level_ids()},
        Prior(None),
        [piece for piece in pieces if piece is not None],
        particles=ParticleParameters().cold_particles,
        report=15,
        spread=InitialSpread(),
        policy=SearchPolicy(),
        rng=np.random.default_rng(3),
    )


def main() -> None:
    """Run all, print a table, write JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("bench-out"), help="folder for benchmarks.json")
    options = parser.parse_args()
    radio = {levels: radio_search(levels) for levels in (1, 10)}
    figures = {
        **{
            f"particle_step_{features.value}_{n}_us": particle_step(features, n)
            for features in (FeatureSet.HV, FeatureSet.VECTOR)
            for n in (1000, 2000, 5000)
        },
        "map_20000_samples_400x400_s": map_build(),
        "map_gradient_20000_samples_400x400_s": map_build(curl_free=True),
        **segment(),
        "search_one_level_ms": level_search(1),
        "search_ten_levels_ms": level_search(10),
        **{f"search_wifi_{levels}_levels_ms": again for levels, (again, _) in radio.items()},
        **{f"search_wifi_{levels}_levels_first_ms": first for levels, (_, first) in radio.items()},
    }
    for name, value in figures.items():
        print(f"{name:36s} {value:10.2f}")  # noqa: T201 - a command's output
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "benchmarks.json").write_text(json.dumps(figures, indent=1))


if __name__ == "__main__":
    main()
