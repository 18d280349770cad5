"""Many runs of the same walks: they differ by seed, and by what the scenario draws of the prior."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from app.engine.types import DeviceCalibration, Float64Array, GridMap, Progress
from app.evaluation.corners import corner_errors, run_error, scored_corners
from app.evaluation.datasets.walks import RecordedWalk
from app.evaluation.metrics import StepScores, Summary, score_steps, summarize
from app.evaluation.pool import map_tasks, process_pool
from app.evaluation.protocol import Aids, Scenario
from app.evaluation.replay import CreateTracker, EngineJob, Job, replay_in_engine
from app.evaluation.results import Dropped, ScoredTrack, WalkResult
from app.evaluation.truth import SurveyedArea

RUNS_A_JOB = 10
"""Runs handed to a process at a time."""


@dataclass(frozen=True, slots=True)
class Run:
    """One run of one walk.

    Attributes
    ----------
    number : int
    device : str
    result : WalkResult
    whole, whole_baseline : StepScores
        The fixes and those of dead reckoning, scored from the first label on without the grace of the first seconds.
    corner_errors : array, shape (n,), m
        At the corners that the gyroscope shows (see :mod:`app.evaluation.corners`).
    """

    number: int
    device: str
    result: WalkResult
    whole: StepScores
    corner_errors: Float64Array
    whole_baseline: StepScores | None = None

    @property
    def error_m(self) -> float | None:
        """The run's error by the protocol of the corners."""
        return run_error(self.corner_errors)

    @property
    def first_fix_m(self) -> float | None:
        """Distance walked until the first step whose fix claims a position, m; None if none does."""
        located = self.whole.located
        return float(self.whole.travelled[int(np.argmax(located))]) if located.any() else None

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON: those of a walk, and the run's own."""
        first = self.first_fix_m
        return self.result.as_dict() | {
            "run": self.number,
            "device": self.device,
            "first_fix_m": None if first is None else round(first, 3),
            "corner_errors_m": [round(e, 3) if np.isfinite(e) else None for e in self.corner_errors.tolist()],
        }


@dataclass(frozen=True, slots=True)
class RunsTask:
    """Runs of one walk (``work.job`` holds it alone); pickles if ``work`` does."""

    work: EngineJob
    runs: tuple[int, ...]


def replay_runs(task: RunsTask) -> tuple[Run | Dropped, ...]:
    """Replay and score the runs of a task, in order; a walk that cannot be scored is dropped once."""
    (walk,) = task.work.job.walks
    corners = scored_corners(walk.samples, walk.waypoints)
    runs: list[Run | Dropped] = []
    for number in task.runs:
        (result,) = replay_in_engine(replace(task.work, job=replace(task.work.job, repeat=number)))
        if isinstance(result, Dropped):
            return (result,) if number == 0 else ()
        runs.append(
            Run(
                number=number,
                device=walk.device,
                result=result,
                whole=_whole(result, result.causal),
                corner_errors=corner_errors(result.causal.fixes, corners, walk.waypoints),
                whole_baseline=_whole(result, result.baseline) if result.baseline else None,
            )
        )
    return tuple(runs)


def _whole(result: WalkResult, track: ScoredTrack) -> StepScores:
    return score_steps(
        result.truth, track.fixes, start_t=-np.inf, level_id=result.level, prior=result.prior, grace_s=0.0
    )


@dataclass(frozen=True, slots=True)
class Bench:
    """What the runs share: one level with its map and survey, the tracker, and what is known of the device."""

    level: str
    grid_map: GridMap
    area: SurveyedArea
    method: str
    parameters: Mapping[str, object]
    create_tracker: CreateTracker
    calibration: DeviceCalibration | None = None

    def tasks(self, walks: Sequence[RecordedWalk], scenario: Scenario, runs: int) -> list[RunsTask]:
        """Work orders for ``runs`` runs of each walk."""
        tasks = []
        for walk in walks:
            job = Job(self.level, self.level, "", (walk,), self.area, scenario, Aids(), 0, self.calibration)
            maps = {self.level: self.grid_map}
            work = EngineJob(job, maps, self.method, self.parameters, self.create_tracker)
            tasks += [
                RunsTask(work, tuple(range(first, min(first + RUNS_A_JOB, runs))))
                for first in range(0, runs, RUNS_A_JOB)
            ]
        return tasks


def replay_all(
    tasks: Sequence[RunsTask], jobs: int, warm_up: Callable[[], None], say: Progress
) -> tuple[tuple[Run, ...], tuple[Dropped, ...]]:
    """Replay the tasks, ``jobs`` side by side; runs and dropped walks in the order of the tasks."""
    with process_pool(jobs, warm_up) as pool:
        parts = map_tasks(pool, replay_runs, tasks, lambda done, n: say(done / n, f"part {done} of {n}"))
    results = [result for part in parts for result in part]
    return (
        tuple(r for r in results if isinstance(r, Run)),
        tuple(r for r in results if isinstance(r, Dropped)),
    )


def failures_of(runs: Sequence[Run]) -> tuple[str, ...]:
    """A note if segments failed; a report must not pass over them."""
    failures = [failure for run in runs for failure in run.result.failures]
    return (f"{len(failures)} failures; the first: {failures[0]}",) if failures else ()


@dataclass(frozen=True, slots=True)
class FirstFix:
    """How soon the runs claim a position, and how well from there on.

    ``found_share``: runs with such a fix. ``p50_m`` and ``p90_m``: distance walked until it, over these runs.
    ``after``: errors of their steps from it on.
    """

    found_share: float | None
    p50_m: float | None
    p90_m: float | None
    after: Summary

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        own = {name: getattr(self, name) for name in ("found_share", "p50_m", "p90_m")}
        rounded = {name: None if value is None else round(value, 4) for name, value in own.items()}
        return rounded | {"after": self.after.as_dict()}


def first_fixes(runs: Sequence[Run]) -> FirstFix:
    """Summary of the runs' first fixes."""
    found = [run for run in runs if run.first_fix_m is not None]
    distance = np.array([run.first_fix_m for run in found])
    return FirstFix(
        found_share=len(found) / len(runs) if runs else None,
        p50_m=float(np.quantile(distance, 0.5)) if found else None,
        p90_m=float(np.quantile(distance, 0.9)) if found else None,
        after=summarize([run.whole.since(int(np.argmax(run.whole.located))) for run in found]),
    )
