"""Runs that call the engine directly."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from app.engine.errors import InputError
from app.engine.localization import DEFAULT_METHOD, create_tracker, warm_up
from app.engine.types import GridMap, Progress
from app.evaluation.datasets.walks import RecordedWalk
from app.evaluation.drivers import FieldRaster, Smoother, smooth_in_engine
from app.evaluation.errors import OptionsError
from app.evaluation.levels import LevelsOfRun, Outcome, prepare_task, replay_job, walks_to_replay
from app.evaluation.pool import map_tasks, process_pool
from app.evaluation.prepare import PreparedLevel, PrepareTask, prepare_level
from app.evaluation.protocol import EvaluationOptions, Scenario
from app.evaluation.replay import CreateTracker, EngineJob, aids_change_answers, replay_in_engine

WALKS_A_JOB = 4
"""Walks handed to a process at a time: few enough to share the work out, enough to be worth sending the map."""
WALKS_A_VENUE_JOB = 12
"""The same where the maps of a whole building go along."""
WALKS_TO_ASK_FOR_AIDS = 3


@dataclass(frozen=True, slots=True)
class Engine:
    """The parts of the engine that a run uses; tests put others in their place. All are module-level functions."""

    create_tracker: CreateTracker
    default_method: str
    warm_up: Callable[[], None]
    prepare: Callable[[PrepareTask], PreparedLevel] = prepare_level
    smoother: Smoother | None = None


def default_engine() -> Engine:
    """The real engine."""
    return Engine(create_tracker, DEFAULT_METHOD, warm_up, smoother=smooth_in_engine)


def check_method(engine: Engine, method: str, parameters: Mapping[str, object]) -> None:
    """Raise :class:`OptionsError` for a method or parameters that the engine does not know."""
    try:
        engine.create_tracker(method, parameters)
    except InputError as error:
        raise OptionsError(error.field, error.message) from error


def run_through_engine(levels: LevelsOfRun, options: EvaluationOptions, engine: Engine, say: Progress) -> Outcome:
    """Build all maps, then replay the walks, both in ``options.jobs`` processes."""
    engine.warm_up()
    tasks = [prepare_task(level, options, with_map=True) for level in levels.mapped]
    with process_pool(options.jobs, engine.warm_up) as pool:
        prepared = map_tasks(pool, engine.prepare, tasks, lambda done, n: say(0.3 * done / n, f"map {done} of {n}"))
        maps = {level.name: level.grid_map for level in prepared if level.grid_map}
        work = _jobs(levels, prepared, maps, options, engine)
        results = map_tasks(
            pool, replay_in_engine, work, lambda done, n: say(0.3 + 0.55 * done / n, _walks_done(done, work))
        )
    rasters = {name: FieldRaster.of(grid_map) for name, grid_map in maps.items()}
    used = _aids_are_used(work) if options.aids else None
    return Outcome(tuple(r for part in results for r in part), prepared, rasters, used)


def _aids_are_used(work: Sequence[EngineJob]) -> bool:
    asked = [replace(one, job=replace(one.job, walks=one.job.walks[:WALKS_TO_ASK_FOR_AIDS])) for one in work[:1]]
    return any(aids_change_answers(one) for one in asked)


def _jobs(
    levels: LevelsOfRun,
    prepared: Sequence[PreparedLevel],
    maps: Mapping[str, GridMap],
    options: EvaluationOptions,
    engine: Engine,
) -> list[EngineJob]:
    ready = {level.name: level for level in prepared}
    size = WALKS_A_VENUE_JOB if options.scenario is Scenario.VENUE else WALKS_A_JOB
    work: list[EngineJob] = []
    for level in levels.evaluated:
        if level.name not in maps:
            continue
        own_maps = {name: maps[name] for name in levels.offered(level, options.scenario) if name in maps}
        for walks in _chunks(walks_to_replay(level, options), size):
            job = replay_job(level, (level.name, level.site), walks, ready[level.name], options)
            work.append(
                EngineJob(job, own_maps, options.method, options.parameters, engine.create_tracker, engine.smoother)
            )
    return work


def _chunks(walks: tuple[RecordedWalk, ...], size: int) -> Iterator[tuple[RecordedWalk, ...]]:
    for start in range(0, len(walks), size):
        yield walks[start : start + size]


def _walks_done(done: int, work: Sequence[EngineJob]) -> str:
    total = sum(len(one.job.walks) for one in work)
    return f"walk {round(total * done / len(work))} of {total}"
