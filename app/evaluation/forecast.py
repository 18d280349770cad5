"""Whether the forecast of accuracy comes true: expected and achieved errors of survey walks that the map does not hold.

One walk in four is left out of each level's survey, the map is built of the rest, and the walks left out are tracked on
it (scenario ``tracking``). Beside each step's error stands what the forecast of the true route expected there. Only
walks of the ``train`` split are used.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np
from scipy import stats

from app.engine.errors import InputError
from app.engine.mapping.forecast import WalkerErrors, forecast_route
from app.engine.types import Float64Array, GridMap, Progress
from app.evaluation.datasets.ilc20 import Ilc20Level, open_ilc20
from app.evaluation.levels import prepare_task, replay_job
from app.evaluation.protocol import PRIOR_RADIUS_M, EvaluationOptions
from app.evaluation.replay import EngineJob, replay_in_engine
from app.evaluation.results import WalkResult
from app.evaluation.tables import layout, length_cell
from app.evaluation.through_engine import Engine, default_engine

FOLDS = 4
STRETCH_M = 10.0
_LEAST_STEPS = 5


@dataclass(frozen=True, slots=True)
class Pair:
    """Root mean square of expected and achieved errors over a walk or a stretch, m."""

    expected: float
    achieved: float


@dataclass(frozen=True, slots=True)
class Agreement:
    """How expected and achieved errors go together; correlations are Spearman's, None with fewer than three pairs."""

    n: int
    rank_correlation: float | None
    expected_m: float | None
    achieved_m: float | None
    ratio_p50: float | None
    """Median of achieved over expected."""

    @classmethod
    def of(cls, pairs: Sequence[Pair]) -> Agreement:
        """Of walks or stretches."""
        if len(pairs) < 3:
            return cls(len(pairs), None, None, None, None)
        expected = np.array([pair.expected for pair in pairs])
        achieved = np.array([pair.achieved for pair in pairs])
        return cls(
            n=len(pairs),
            rank_correlation=float(stats.spearmanr(expected, achieved).statistic),
            expected_m=float(np.sqrt((expected**2).mean())),
            achieved_m=float(np.sqrt((achieved**2).mean())),
            ratio_p50=float(np.median(achieved / expected)),
        )


@dataclass(frozen=True, slots=True)
class LevelAgreement:
    """Agreement on one level: by walk, and by stretch of ten metres."""

    level: str
    walks: Agreement
    stretches: Agreement


@dataclass(frozen=True, slots=True)
class ForecastReport:
    """All levels, and everything pooled."""

    levels: tuple[LevelAgreement, ...]
    walks: Agreement
    stretches: Agreement

    def to_json(self) -> str:
        """As JSON text."""
        return json.dumps(asdict(self), indent=1)

    def table(self) -> str:
        """As text: what was expected and achieved by walk, and by stretch of ten metres."""
        rows: list[tuple[str, ...]] = [
            ("level", "walks", "expected m", "achieved m", "ratio", "rank corr.", "10 m: n", "ratio", "rank corr.")
        ]
        for name, walks, stretches in [
            *((one.level, one.walks, one.stretches) for one in self.levels),
            ("all", self.walks, self.stretches),
        ]:
            lengths = (walks.expected_m, walks.achieved_m, walks.ratio_p50, walks.rank_correlation)
            rest = (stretches.ratio_p50, stretches.rank_correlation)
            rows.append((name, str(walks.n), *map(length_cell, lengths), str(stretches.n), *map(length_cell, rest)))
        return "\n".join(layout(rows, left=1))


def run_forecast(
    options: EvaluationOptions, *, engine: Engine | None = None, say: Progress | None = None
) -> ForecastReport:
    """Compare forecasts with what walks left out achieve."""
    engine = engine or default_engine()
    found = open_ilc20(options.data)
    names = options.levels or found.levels()
    levels, walks, stretches = [], list[Pair](), list[Pair]()
    for i, name in enumerate(names):
        if say is not None:
            say(i / len(names), name)
        by_walk, by_stretch = _level(found.level(name), options, engine)
        levels.append(LevelAgreement(name, Agreement.of(by_walk), Agreement.of(by_stretch)))
        walks += by_walk
        stretches += by_stretch
    return ForecastReport(tuple(levels), Agreement.of(walks), Agreement.of(stretches))


def _level(level: Ilc20Level, options: EvaluationOptions, engine: Engine) -> tuple[list[Pair], list[Pair]]:
    walks = level.walks("train")
    asked = walks[::FOLDS][: options.limit]
    left_out = {walk.walk_id for walk in walks[::FOLDS]}
    task = prepare_task(level, options, with_map=True)
    task = replace(task, walks=tuple(walk for walk in task.walks if walk.walk_id not in left_out))
    ready = engine.prepare(task)
    if ready.grid_map is None:
        return [], []
    job = replay_job(level, (level.name, level.site), asked, ready, options)
    maps = {level.name: ready.grid_map}
    work = EngineJob(
        job, maps, options.method or engine.default_method, options.parameters, engine.create_tracker, None
    )
    by_walk, by_stretch = list[Pair](), list[Pair]()
    for result in replay_in_engine(work):
        if isinstance(result, WalkResult):
            way, expected, achieved = _steps(ready.grid_map, result)
            by_walk += _pairs(np.zeros(len(way)), expected, achieved)
            by_stretch += _pairs(way // STRETCH_M, expected, achieved)
    return by_walk, by_stretch


def _steps(grid_map: GridMap, result: WalkResult) -> tuple[Float64Array, Float64Array, Float64Array]:
    """Way, expected and achieved error at the scored steps of a walk."""
    scores = result.causal.scores
    known = np.isfinite(scores.error)
    way, none = scores.travelled[known], np.empty(0)
    # a prior within a disc: half the radius per axis
    errors = WalkerErrors(position_m=0.5 * PRIOR_RADIUS_M)
    try:
        forecast = forecast_route(grid_map, np.stack([result.truth.x, result.truth.y], axis=1), errors)
    except InputError:  # a walk that stays where it is
        return none, none, none
    return way, np.interp(way, forecast.way, forecast.error), scores.error[known]


def _pairs(part: Float64Array, expected: Float64Array, achieved: Float64Array) -> Iterator[Pair]:
    for one in np.unique(part):
        mine = part == one
        if mine.sum() >= _LEAST_STEPS:
            yield Pair(float(np.sqrt((expected[mine] ** 2).mean())), float(np.sqrt((achieved[mine] ** 2).mean())))
