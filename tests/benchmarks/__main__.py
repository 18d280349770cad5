"""Kernels and map building, timed: ``python -m tests.benchmarks --out DIR``.

CPU seconds of one thread, median of several rounds after a warm-up. The figures in docs/benchmarks.md come from here.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from app.engine.filtering import Cloud, FilterGrid, ParticleNoise, advance_cloud, prepare_grid
from app.engine.inertial import advance
from app.engine.localization import create_tracker
from app.engine.localization.initial import InitialSpread
from app.engine.localization.particle import ParticleParameters
from app.engine.localization.profile import newest
from app.engine.localization.search import SearchPolicy, search
from app.engine.mapping import Covariance, FieldLevel, FieldSamples, krige_grid
from app.engine.types import FeatureSet, Prior, Segment
from tests.engine.conftest import CORNERS, OneMap
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


def map_build() -> float:
    """Seconds for 20,000 three-component samples onto 400 x 400 nodes with standard deviation."""
    rng = np.random.default_rng(0)
    a = rng.uniform(0, 100, 20_000)
    xy = np.stack([a, 2.0 * rng.integers(0, 50, 20_000) + 0.1 * rng.standard_normal(20_000)], axis=1)
    samples = FieldSamples(xy, rng.integers(0, 80, 20_000), rng.standard_normal((20_000, 3)))
    level, axis = FieldLevel(np.zeros(3), np.ones(3)), 0.25 * np.arange(400)
    return median_cpu(lambda: krige_grid(samples, level, Covariance(), axis, axis), rounds=3)


def segment() -> dict[str, float]:
    """Milliseconds of a 5-s segment: motion alone, and the whole tracker."""
    field = Field.random(np.random.default_rng(1))
    walk = walk_through(CORNERS, field, np.random.default_rng(2))
    source = OneMap(true_map(field, (0.0, 0.0, 42.0, 22.0)))
    pieces = cut(walk.samples, seconds=5.0)
    tracker = create_tracker("particle")
    state, _ = tracker.step(tracker.start(Prior("sim", 2.0, 2.0), seed=1), Segment(pieces[0]), source)
    before, _ = advance(None, pieces[0])
    return {
        "motion_ms": 1e3 * median_cpu(lambda: advance(before, pieces[1]), repeat=20),
        "segment_ms": 1e3 * median_cpu(lambda: tracker.step(state, Segment(pieces[1]), source), repeat=20),
    }


def level_search(levels: int) -> float:
    """Milliseconds to search a walk of 60 steps on levels of 100 m x 60 m."""
    field = Field.random(np.random.default_rng(1))
    walk = walk_through(np.array([[5.0, 5.0], [40.0, 5.0], [40.0, 30.0]]), field, np.random.default_rng(2))
    _, events = advance(None, walk.samples)
    grid = prepare_grid(true_map(field, (0.0, 0.0, 100.0, 60.0)), FeatureSet.VECTOR)
    grids = {str(k): grid for k in range(levels)}

    def task() -> None:
        search(
            newest(events, 60), grids, Prior(None), particles=ParticleParameters().cold_particles, report=15,
            spread=InitialSpread(), policy=SearchPolicy(), rng=np.random.default_rng(3),
        )  # fmt: skip

    return 1e3 * median_cpu(task, rounds=5)


def main() -> None:
    """Run all, print a table, write JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("bench-out"), help="folder for benchmarks.json")
    options = parser.parse_args()
    figures = {
        **{
            f"particle_step_{features.value}_{n}_us": particle_step(features, n)
            for features in (FeatureSet.HV, FeatureSet.VECTOR)
            for n in (1000, 2000, 5000)
        },
        "map_20000_samples_400x400_s": map_build(),
        **segment(),
        "search_one_level_ms": level_search(1),
        "search_ten_levels_ms": level_search(10),
    }
    for name, value in figures.items():
        print(f"{name:36s} {value:10.2f}")  # noqa: T201 - a command's output
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "benchmarks.json").write_text(json.dumps(figures, indent=1))


if __name__ == "__main__":
    main()
