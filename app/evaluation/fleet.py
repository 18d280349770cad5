"""What it is worth to know a phone: left-out survey walks that start with nothing, their model, their own memory.

Walks of the train split are left out in turn. A map is built of the others, which teach their phones as a service would
let them; the left-out walks are then replayed from the first label, once with each start. The offset that a start
expects is compared with the one that building finds when no walk is left out.

>>> from pathlib import Path
>>> from app.evaluation.fleet import FleetOptions, run_fleet
>>> print(run_fleet(FleetOptions(Path("data"))).table())  # doctest: +SKIP
"""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from app.engine.calibration import estimate_model, next_session, remember_offsets, unknown_device, with_model
from app.engine.errors import InputError
from app.engine.mapping import build_map
from app.engine.mapping.adjustment import adjust_walks
from app.engine.mapping.offsets import estimate_offsets
from app.engine.mapping.samples import place_samples
from app.engine.types import DeviceCalibration, Float64Array, GridMap, Progress, WalkReport
from app.evaluation.datasets.ilc20 import Ilc20Level, open_ilc20
from app.evaluation.datasets.walks import RecordedWalk
from app.evaluation.errors import DataSetError, OptionsError
from app.evaluation.metrics import score_steps
from app.evaluation.prepare import surveyed_area
from app.evaluation.protocol import Aids, Scenario
from app.evaluation.replay import EngineJob, Job, replay_in_engine
from app.evaluation.results import Dropped
from app.evaluation.tables import layout
from app.evaluation.through_engine import Engine, default_engine

STARTS = ("nothing", "model", "device")
"""What a session knows of its phone's magnetometer before it begins."""
EARLY_S = 10.0
_MIN_DEVICES = 3
_INSIDE_95 = 1.959964


@dataclass(frozen=True, slots=True)
class FleetOptions:
    """What to evaluate, and how.

    Attributes
    ----------
    data : Path
        Folder that holds ``ilc20/``.
    levels : tuple of str
        Names of levels; empty: all that are found.
    folds : int
        Parts that the train walks are left out in.
    track : bool
        Replay the left-out walks; without it only offsets are compared, in a tenth of the time.
    """

    data: Path
    levels: tuple[str, ...] = ()
    folds: int = 4
    track: bool = True
    method: str = ""

    def __post_init__(self) -> None:
        if self.folds < 2:
            raise OptionsError("folds", f"needs at least 2, got {self.folds}")


@dataclass(frozen=True, slots=True)
class StartScore:
    """One left-out walk with one start.

    Attributes
    ----------
    offset_error, normalized : arrays, shape (3,), uT and 1
        Offset found less the one expected, and the same over its claimed standard deviation.
    early_m, all_m : arrays, m
        Errors of the causal fixes at the steps of the first ten seconds, and at all steps, from the first label on.
    """

    level: str
    walk_id: str
    start: str
    known: bool
    offset_error: Float64Array
    normalized: Float64Array
    early_m: Float64Array
    all_m: Float64Array

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {
            "level": self.level,
            "walk_id": self.walk_id,
            "start": self.start,
            "device_known": self.known,
            "offset_error_ut": np.round(self.offset_error, 3).tolist(),
            "normalized": np.round(self.normalized, 3).tolist(),
            "early_errors_m": np.round(self.early_m, 3).tolist(),
        }


@dataclass(frozen=True, slots=True)
class FleetReport:
    """Result of a run."""

    scores: tuple[StartScore, ...]

    def summary(self) -> dict[str, dict[str, dict[str, float | int | None]]]:
        """Figures by level (``all``: together) and start."""
        levels = {"all": self.scores}
        levels |= {name: tuple(s for s in self.scores if s.level == name) for name in self._levels()}
        return {
            name: {start: _figures([s for s in scores if s.start == start]) for start in STARTS}
            for name, scores in levels.items()
        }

    def to_json(self) -> str:
        """The report as JSON text."""
        walks = [score.as_dict() for score in self.scores]
        return json.dumps({"set": "fleet", "summary": self.summary(), "walks": walks}, indent=1)

    def table(self) -> str:
        """The report as text."""
        head = (
            "level",
            "start",
            "walks",
            "offset error rms / p50",
            "horizontal rms",
            "in 95 %",
            "first 10 s p50 / p90",
        )
        rows = [
            (
                name if start == STARTS[0] else "",
                start,
                str(f["walks"]),
                f"{_cell(f['offset_rms_ut'])} / {_cell(f['offset_p50_ut'])} uT",
                f"{_cell(f['horizontal_rms_ut'])} uT",
                "-" if f["inside_95"] is None else f"{100 * f['inside_95']:.0f} %",
                f"{_cell(f['early_p50_m'])} / {_cell(f['early_p90_m'])} m",
            )
            for name, starts in self.summary().items()
            for start, f in starts.items()
        ]  # fmt: skip
        return "\n".join(layout([head, *rows], left=2))

    def _levels(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(score.level for score in self.scores))


def run_fleet(options: FleetOptions, progress: Progress | None = None, engine: Engine | None = None) -> FleetReport:
    """Leave walks out in turn, level by level.

    Raises
    ------
    DataSetError
        No walk tells which phone it is of (``mag_bias_x/y/z`` of ``traces.parquet``).
    """
    say = progress or (lambda _fraction, _text: None)
    engine = engine or default_engine()
    data = open_ilc20(options.data)
    names = options.levels or data.levels()
    scores: list[StartScore] = []
    for number, name in enumerate(names):
        level = data.level(name)
        walks = level.walks("train")
        if not any(walk.calibration_epoch for walk in walks):
            raise DataSetError(level.folder / "traces.parquet", "needs mag_bias_x, mag_bias_y and mag_bias_z")
        truth = _offsets(walks)
        rng = np.random.default_rng(0)
        fold = rng.permutation(len(walks)) % options.folds
        for f in range(options.folds):
            say((number + f / options.folds) / len(names), f"{name}, part {f + 1} of {options.folds}")
            others = [walk for walk, k in zip(walks, fold, strict=True) if k != f]
            left_out = [walk for walk, k in zip(walks, fold, strict=True) if k == f and walk.walk_id in truth]
            scores += _fold(level, others, left_out, truth, options, engine)
    say(1.0, "done")
    return FleetReport(tuple(scores))


def _fold(
    level: Ilc20Level,
    others: Sequence[RecordedWalk],
    left_out: Sequence[RecordedWalk],
    truth: Mapping[str, Float64Array],
    options: FleetOptions,
    engine: Engine,
) -> Iterator[StartScore]:
    if options.track:
        build = build_map(level.name, [walk.survey_walk() for walk in others])
        grid: GridMap | None = build.grid_map
        found = {report.walk_id: np.array(report.offset) for report in build.walks if _usable(report)}
    else:
        grid, found = None, _offsets(others)
    memories = _memories(others, found)
    area = surveyed_area([walk.survey_walk() for walk in others])
    for walk in left_out:
        for name, start in _starts(memories, walk.calibration_epoch).items():
            job = Job(level.name, level.name, "", (walk,), area, Scenario.TRACKING, Aids(), 0, start)
            expected = start or unknown_device()
            error = truth[walk.walk_id] - np.array(expected.offset)
            early, all_steps = (np.empty(0), np.empty(0)) if grid is None else _track(job, grid, options, engine)
            yield StartScore(
                level=level.name,
                walk_id=walk.walk_id,
                start=name,
                known=walk.calibration_epoch in memories,
                offset_error=error,
                normalized=error / np.array(expected.offset_sd),
                early_m=early,
                all_m=all_steps,
            )


def _usable(report: WalkReport) -> bool:
    return report.rejected is None


def _offsets(walks: Sequence[RecordedWalk]) -> dict[str, Float64Array]:
    """Hard iron of each walk that can be placed, found against the others; uT, forward, left, up."""
    placed = []
    for walk in walks:
        try:
            placed.append(place_samples(walk.survey_walk()))
        except InputError:
            continue  # building leaves it out too
    placed = adjust_walks(placed)
    return dict(zip((walk.walk_id for walk in placed), estimate_offsets(placed).hard_iron, strict=True))


def _memories(walks: Sequence[RecordedWalk], offsets: Mapping[str, Float64Array]) -> dict[str, DeviceCalibration]:
    """What walks teach each phone in each of its epochs."""
    by_epoch: defaultdict[str, list[list[float]]] = defaultdict(list)
    for walk in walks:
        if walk.walk_id in offsets:
            by_epoch[walk.calibration_epoch].append(offsets[walk.walk_id].tolist())
    return {epoch: remember_offsets(unknown_device(), found) for epoch, found in by_epoch.items()}


def _starts(memories: Mapping[str, DeviceCalibration], epoch: str) -> dict[str, DeviceCalibration | None]:
    """What a session of a phone in this epoch starts with, by what is known: see :data:`STARTS`.

    An epoch stands for a phone: which epochs are of one phone is not recorded.
    """
    siblings = [memory for other, memory in memories.items() if other != epoch]
    model = estimate_model(siblings).start if len(siblings) >= _MIN_DEVICES else None
    own = memories.get(epoch)
    device = model
    if own is not None:
        device = next_session(own) if model is None else with_model(next_session(own), model)
    return dict(zip(STARTS, (None, model, device), strict=True))


def _track(job: Job, grid: GridMap, options: FleetOptions, engine: Engine) -> tuple[Float64Array, Float64Array]:
    """Errors at the steps of the first seconds, and at all, m."""
    work = EngineJob(job, {job.level: grid}, options.method or engine.default_method, {}, engine.create_tracker)
    (result,) = replay_in_engine(work)
    if isinstance(result, Dropped):
        return np.empty(0), np.empty(0)
    scores = score_steps(
        result.truth,
        result.causal.fixes,
        start_t=result.start_t,
        level_id=job.level_id,
        prior=result.prior,
        grace_s=0.0,
    )
    return scores.error[scores.t < result.start_t + EARLY_S], scores.error


def _figures(scores: Sequence[StartScore]) -> dict[str, float | int | None]:
    if not scores:
        return {"walks": 0}
    error = np.array([score.offset_error for score in scores])
    size = np.linalg.norm(error, axis=1)
    early = np.concatenate([score.early_m for score in scores])
    every = np.concatenate([score.all_m for score in scores])
    normalized = np.array([score.normalized for score in scores])
    return {
        "walks": len(scores),
        "device_known": round(float(np.mean([score.known for score in scores])), 3),
        "offset_rms_ut": round(float(np.sqrt((size**2).mean())), 3),
        "offset_p50_ut": round(float(np.median(size)), 3),
        "horizontal_rms_ut": round(float(np.sqrt((error[:, :2] ** 2).sum(axis=1).mean())), 3),
        "inside_95": round(float((np.abs(normalized) < _INSIDE_95).mean()), 3),
        "early_p50_m": _quantile(early, 0.5),
        "early_p90_m": _quantile(early, 0.9),
        "all_p50_m": _quantile(every, 0.5),
        "all_p90_m": _quantile(every, 0.9),
    }


def _quantile(values: Float64Array, q: float) -> float | None:
    finite = values[np.isfinite(values)]
    return round(float(np.quantile(finite, q)), 3) if len(finite) else None


def _cell(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"
