"""Stand-ins of the ``kaist`` and ``uji`` folders, made of simulated walks over one simulated field."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from PIL import Image

from app.engine.types import Float64Array, ImuSamples
from app.evaluation.datasets.uji import COMPASS_PULL
from tests.support.walks import Field, SimulatedWalk, walk_through

START_MS = 1_580_793_774_861
FIELD = Field.random(np.random.default_rng(11), sd=8.0)
TRACK = np.array([[2.0, 2.0], [18.0, 2.0], [18.0, 14.0], [10.0, 14.0], [10.0, 6.0], [3.0, 6.0]])


@dataclass(frozen=True)
class Recording:
    """A walk of a stand-in; ``corners`` (n, 2) m are passed at ``t`` (n,), s since the start."""

    name: str
    kind: str
    device: str
    samples: ImuSamples
    t: Float64Array
    corners: Float64Array


def record(
    name: str, kind: str, corners: Float64Array, *, device: str = "Galaxy S9", carry: float = 0.0, seed: int = 0,
    hard_iron: Float64Array | None = None,
) -> Recording:  # fmt: skip
    walk = walk_through(
        corners, FIELD, np.random.default_rng(seed), carry=carry, hard_iron=hard_iron, t0=START_MS / 1000
    )
    return Recording(name, kind, device, walk.samples, _passed(walk, corners), corners)


def _passed(walk: SimulatedWalk, corners: Float64Array) -> Float64Array:
    along = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1))))
    since = walk.samples.t - walk.samples.t[0]
    return np.round(along / along[-1] * since[-1], 3)


def hall() -> list[Recording]:
    """Survey lines 1 m apart, along x and one along y, the phone along +x on all; two tracks of two phones."""
    lines = [
        record(f"survey-{i:03}", "survey", np.array([[0.0, y], [20.0, y]]), seed=i)
        for i, y in enumerate(np.arange(0.0, 17.0))
    ]
    lines.append(record("survey-099", "survey", np.array([[1.0, 0.0], [1.0, 16.0]]), carry=-np.pi / 2, seed=99))
    return [
        *lines,
        record("test-s9-1", "test", TRACK, seed=201),
        record("test-other-1", "test", TRACK, device="Other 2 Pro", seed=202, hard_iron=np.array([3.0, -2.0, 4.0])),
    ]


def write_kaist(folder: Path, recordings: Sequence[Recording]) -> None:
    """Write recordings in the ``kaist`` folder format."""
    folder.mkdir(parents=True)
    counts = [len(r.samples) for r in recordings]
    _write(
        folder / "traces.parquet",
        trace_id=[r.name for r in recordings],
        kind=[r.kind for r in recordings],
        device=[r.device for r in recordings],
        row_start=np.cumsum([0, *counts[:-1]]),
        n_samples=counts,
        start_unix_ms=[START_MS] * len(recordings),
    )
    columns = {"t": np.concatenate([_milliseconds(r.samples.t - START_MS / 1000) for r in recordings])}
    for sensor, name in (("m", "mag"), ("a", "acc"), ("g", "gyro")):
        values = np.concatenate([getattr(r.samples, name) for r in recordings]).astype(np.float32)
        columns |= {sensor + axis: values[:, i] for i, axis in enumerate("xyz")}
    _write(folder / "imu.parquet", **columns)
    _write(
        folder / "waypoints.parquet",
        trace_id=[r.name for r in recordings for _ in r.t],
        t=np.concatenate([_milliseconds(r.t) for r in recordings]),
        x=np.concatenate([r.corners[:, 0] for r in recordings]).astype(np.float32),
        y=np.concatenate([r.corners[:, 1] for r in recordings]).astype(np.float32),
    )
    floor = {
        "walkable": {
            "outer": [[-1, -1], [21, -1], [21, 17], [-1, 17]],
            "holes": [[[12, 8], [14, 8], [14, 10], [12, 10]]],
        },
        "image": {"m_per_px": 0.5, "bottom_left_m": [-1, -1]},
    }
    (folder / "floor.json").write_text(json.dumps(floor))
    Image.new("L", (44, 36), 255).save(folder / "floor_image.png")
    runs = [(method, track, error) for method, error in (("ILoA", 1.5), ("MaLoc", 12.0)) for track in (1, 2, 3)]
    _write(
        folder / "published_runs.parquet",
        method=[run[0] for run in runs],
        particles=[4000] * len(runs),
        step_m=[1.0] * len(runs),
        track=[run[1] for run in runs],
        mean_err_from_3rd_m=[run[2] for run in runs],
    )


def write_uji(folder: Path, recordings: Sequence[Recording]) -> None:
    """Write recordings in the ``uji`` folder format: 10 Hz, attitude and field at 5 Hz, two stale rows."""
    folder.mkdir(parents=True)
    _write(
        folder / "traces.parquet",
        trace_id=[r.name for r in recordings],
        split=[r.kind for r in recordings],
        start_unix_ms=[START_MS] * len(recordings),
    )
    parts = [_uji_columns(r) for r in recordings]
    _write(folder / "samples.parquet", **{name: np.concatenate([part[name] for part in parts]) for name in parts[0]})


def _uji_columns(r: Recording) -> dict[str, np.ndarray]:
    rows = np.arange(0, len(r.samples), 5)
    since = (r.samples.t - r.samples.t[0])[rows]
    heading = np.degrees(np.cumsum(r.samples.gyro[:, 2]) * 0.02) + _first_bearing(r)
    fresh = rows - 5 * (np.arange(len(rows)) % 2)  # every second row repeats
    azimuth = (90.0 - heading[fresh] + _drawn(r, np.radians(heading))[fresh] + 180.0) % 360.0 - 180.0
    mag = r.samples.mag[fresh]
    azimuth[:2], mag[:2] = 0.0, 0.0
    linear = r.samples.acc[rows] - [0.0, 0.0, 9.81]
    xy = np.stack([np.interp(since, r.t, r.corners[:, k]) for k in range(2)], axis=1)
    columns = {"trace_id": np.array([r.name] * len(rows)), "t": _milliseconds(since)}
    columns |= {f"m{axis}": mag[:, i] for i, axis in enumerate("xyz")}
    columns |= {f"la{axis}": linear[:, i] for i, axis in enumerate("xyz")}
    columns |= {"azimuth": azimuth, "pitch": np.zeros(len(rows)), "roll": np.zeros(len(rows))}
    segment = np.clip(np.searchsorted(r.t, since, side="right") - 1, 0, len(r.t) - 2)
    return columns | {"x": xy[:, 0], "y": xy[:, 1], "segment": segment}


def _drawn(r: Recording, heading: Float64Array) -> Float64Array:
    """How far the phone's own filter has drawn its azimuth clockwise to the compass, shape (n,), degrees."""
    mag, drawn = r.samples.mag, np.zeros(len(r.samples))
    bearing = np.pi / 2 - heading
    for i in range(1, len(drawn)):
        azimuth = bearing[i] + drawn[i - 1]
        east = np.cos(azimuth) * mag[i, 0] + np.sin(azimuth) * mag[i, 1]
        drawn[i] = drawn[i - 1] - COMPASS_PULL * east * 0.02
    return np.degrees(drawn)


def _first_bearing(r: Recording) -> float:
    dx, dy = r.corners[1] - r.corners[0]
    return float(np.degrees(np.arctan2(dy, dx)))


def laboratory() -> list[Recording]:
    """Lines both ways and curves as survey, one test walk, one walk whose attitude sensor was dead."""
    lines = [
        record(f"l{i}{way}", "train-lines", corners if way == "n" else corners[::-1], seed=i)
        for i, y in enumerate(np.arange(0.0, 17.0, 2.0))
        for way, corners in (("n", np.array([[0.0, y], [20.0, y]])), ("r", np.array([[0.0, y + 1.0], [20.0, y + 1.0]])))
    ]
    curve = np.array([[10.0, 0.0], [10.0, 8.0], [18.0, 8.0], [18.0, 16.0]])
    return [*lines, record("c1", "train-curves", curve, seed=50), record("tt01", "test", TRACK, seed=60)]


def _milliseconds(seconds: Float64Array) -> np.ndarray:
    return np.round(1000.0 * seconds).astype(np.int32)


def _write(path: Path, **columns: object) -> None:
    pq.write_table(pa.table(columns), path)
