"""Problems put to matchers, and how their answers are scored and timed."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from app.engine.errors import EngineError
from app.engine.matching import MATCHERS, MatchProblem
from app.engine.types import FeatureSet, Float64Array, Progress, Status
from app.evaluation.metrics import ELLIPSE95
from app.evaluation.pool import map_tasks, process_pool

_CHUNK = 5
"""Trials that a process takes at a time at least: the first of them is answered twice."""


@dataclass(frozen=True, slots=True)
class Trial:
    """A problem whose answer is known.

    Attributes
    ----------
    name : str
    problem : MatchProblem
    x, y : array, shape (n,), m, level frame
        Where the track truly is.
    """

    name: str
    problem: MatchProblem
    x: Float64Array
    y: Float64Array


@dataclass(frozen=True, slots=True)
class Outcome:
    """What one method made of a trial.

    Attributes
    ----------
    trial : str
    status : Status or None
        None: it refused or failed; ``note`` says why.
    dx, dy : float, m
        Located less true position of the last point; NaN without a place.
    track_error : array, shape (n,), m
        Distance from the truth at each point; empty without a place.
    cpu_s : float, s
        Processor time of the match.
    note : str
    inside : bool
        Whether the true end lies in the 95 % ellipse of the likeliest place.
    x, y : array, shape (n,), m, level frame, or None
        Where the track was put.
    """

    trial: str
    status: Status | None
    dx: float
    dy: float
    track_error: Float64Array
    cpu_s: float
    note: str = ""
    inside: bool = False
    x: Float64Array | None = None
    y: Float64Array | None = None

    @property
    def error(self) -> float:
        """Distance of the last point from the truth, m; infinite without a place."""
        return float(np.hypot(self.dx, self.dy)) if np.isfinite(self.dx + self.dy) else float("inf")

    @property
    def located(self) -> bool:
        """Whether the answer names a place, whatever it claims of it."""
        return bool(np.isfinite(self.dx + self.dy))


@dataclass(frozen=True, slots=True)
class _Task:
    method: str
    trials: tuple[Trial, ...]


def suited(scale: str, features: FeatureSet, *, routes: bool = False) -> tuple[str, ...]:
    """Registered methods that suit a kind of venue and a feature set; they search an area, with ``routes`` lines."""
    return tuple(
        name
        for name, entry in MATCHERS.items()
        if scale in entry.scales and features in entry.features and entry.needs_routes == routes
    )


def registered(names: Sequence[str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Those of the names that are in the registry, and notes about the others."""
    there = tuple(name for name in names if name in MATCHERS)
    return there, tuple(f"{name}: not in the registry, left out" for name in names if name not in MATCHERS)


def run_trials(
    methods: Sequence[str], trials: Sequence[Trial], *, jobs: int = 1, progress: Progress | None = None
) -> dict[str, tuple[Outcome, ...]]:
    """Answers of each method to each trial, in the order of the trials."""
    say = progress or (lambda _fraction, _what: None)
    chunk = max(_CHUNK, -(-len(trials) // (4 * jobs)))
    parts = [tuple(trials[i : i + chunk]) for i in range(0, len(trials), chunk)]
    tasks = [_Task(method, part) for method in methods for part in parts]
    if not tasks:
        return dict.fromkeys(methods, ())

    def done(finished: int, all_: int) -> None:
        say(finished / all_, tasks[min(finished, all_ - 1)].method)

    with process_pool(jobs, _nothing) as pool:
        results = map_tasks(pool, _solve, tasks, done)
    answers: dict[str, tuple[Outcome, ...]] = dict.fromkeys(methods, ())
    for task, outcomes in zip(tasks, results, strict=True):
        answers[task.method] += outcomes
    return answers


def part_of(progress: Progress, start: float, share: float, name: str) -> Progress:
    """Progress of a part of the work."""
    return lambda fraction, what: progress(start + share * fraction, f"{name}: {what}" if what else name)


def _nothing() -> None:
    """A worker needs no warming: each task's first answer is given twice."""


def _solve(task: _Task) -> tuple[Outcome, ...]:
    _one(task.method, task.trials[0])  # compiles what the method needs: not part of its time
    return tuple(_one(task.method, trial) for trial in task.trials)


def _one(method: str, trial: Trial) -> Outcome:
    entry = MATCHERS[method]
    matcher = entry.create(entry.parameters())
    began = time.thread_time()
    try:
        result = matcher.match(trial.problem)
    except EngineError as error:
        return Outcome(trial.name, None, np.nan, np.nan, np.empty(0), time.thread_time() - began, str(error))
    cpu_s = time.thread_time() - began
    if not result.matches:
        return Outcome(trial.name, result.status, np.nan, np.nan, np.empty(0), cpu_s, result.evidence.note)
    best = result.matches[0]
    away = np.stack([best.x - trial.x, best.y - trial.y], axis=1)
    end = away[-1]
    return Outcome(
        trial=trial.name,
        status=result.status,
        dx=float(end[0]),
        dy=float(end[1]),
        track_error=np.hypot(*away.T),
        cpu_s=cpu_s,
        note=result.evidence.note,
        inside=bool(end @ np.linalg.solve(best.cov, end) <= ELLIPSE95),
        x=best.x,
        y=best.y,
    )
