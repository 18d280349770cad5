"""Run an evaluation: prepare the levels, replay the walks, write the report.

>>> from pathlib import Path
>>> from app.evaluation.protocol import EvaluationOptions
>>> report = run_ilc20(EvaluationOptions(Path("maps/samples"), limit=2))  # doctest: +SKIP
>>> print(report.table())  # doctest: +SKIP
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import TypeVar

from app.engine.errors import InputError
from app.engine.localization import DEFAULT_METHOD, create_tracker, warm_up
from app.engine.types import GridMap, Progress, SurveyWalk
from app.evaluation.datasets.ilc20 import Ilc20Level, RecordedWalk, open_ilc20
from app.evaluation.drivers import FieldRaster, HttpDriver, LevelUpload, Smoother, Transport, smooth_in_engine
from app.evaluation.errors import OptionsError
from app.evaluation.pool import map_tasks, process_pool
from app.evaluation.prepare import PreparedLevel, PrepareTask, prepare_level
from app.evaluation.protocol import Aids, EvaluationOptions, Scenario, Through
from app.evaluation.replay import (
    CreateTracker,
    EngineJob,
    Job,
    Results,
    replay_in_engine,
    replay_walks,
    wifi_is_used,
)
from app.evaluation.report import BASELINE, Dropped, MapNote, Report, WalkResult

SET_NAME = "ilc20"
WALKS_A_JOB = 4
"""Walks handed to a process at a time: few enough to share the work out, enough to be worth sending the map."""
WALKS_TO_ASK_FOR_WIFI = 3

T = TypeVar("T")


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


def run_ilc20(
    options: EvaluationOptions,
    progress: Progress | None = None,
    *,
    transport: Transport | None = None,
    engine: Engine | None = None,
) -> Report:
    """Evaluate on a data set in the ilc20 folder format.

    Parameters
    ----------
    options : EvaluationOptions
    progress : callable or None
        ``progress(fraction, what)``.
    transport : Transport or None
        The service, with ``through=http``.
    engine : Engine or None
        None: the real one.

    Raises
    ------
    DataSetError
        The data are not there or not in the format.
    OptionsError
        Options that cannot be honoured.
    TransportError
        The service cannot be reached, or refuses a level, a walk, a map or a session.
    """
    if options.through is Through.HTTP and transport is None:
        raise OptionsError("through", "http needs a transport to a running service")
    engine = engine or default_engine()
    say = progress or _silent
    data = open_ilc20(options.data)
    levels = [data.level(name) for name in options.levels or data.levels()]
    options = replace(options, method=options.method or engine.default_method)
    check_method(engine, options.method, options.parameters)
    if options.through is Through.HTTP and transport is not None:
        run = _through_http(levels, options, engine, transport, say)
    else:
        run = _through_engine(levels, options, engine, say)
    report = _report(options, levels, run)
    if options.plots:
        # matplotlib takes most of a second to import
        from app.evaluation.plots import Backdrop, plot_report

        backdrops = {
            level.name: Backdrop(level.extent, level.plan_png_path, run.rasters.get(level.name)) for level in levels
        }
        plot_report(report, backdrops, options.plots, lambda f, what: say(0.85 + 0.15 * f, what))
    say(1.0, "done")
    return report


@dataclass(frozen=True, slots=True)
class _Run:
    """What a driver's run leaves for the report."""

    results: Results
    prepared: Sequence[PreparedLevel]
    rasters: Mapping[str, FieldRaster]
    aids_used: bool | None = None
    notes: tuple[str, ...] = ()


def check_method(engine: Engine, method: str, parameters: Mapping[str, object]) -> None:
    """Raise :class:`OptionsError` for a method or parameters that the engine does not know."""
    try:
        engine.create_tracker(method, parameters)
    except InputError as error:
        raise OptionsError(error.field, error.message) from error


def _through_engine(levels: Sequence[Ilc20Level], options: EvaluationOptions, engine: Engine, say: Progress) -> _Run:
    engine.warm_up()
    tasks = [
        PrepareTask(
            level.name,
            _survey_walks(level, options),
            options.map_settings,
            options.cache,
            vector_plan=level.vector_plan,
        )
        for level in levels
    ]
    with process_pool(options.jobs, engine.warm_up) as pool:
        prepared = map_tasks(pool, engine.prepare, tasks, lambda done, n: say(0.3 * done / n, f"map {done} of {n}"))
        maps = {level.name: level.grid_map for level in prepared if level.grid_map}
        work = _engine_jobs(levels, prepared, maps, options, engine)
        results = map_tasks(
            pool, replay_in_engine, work, lambda done, n: say(0.3 + 0.55 * done / n, _walks_done(done, work))
        )
    used = None
    if options.aids is Aids.WIFI:
        asked = [replace(one, job=replace(one.job, walks=one.job.walks[:WALKS_TO_ASK_FOR_WIFI])) for one in work[:1]]
        used = any(wifi_is_used(one) for one in asked)
    rasters = {name: FieldRaster.of(grid_map) for name, grid_map in maps.items()}
    return _Run(tuple(r for part in results for r in part), prepared, rasters, used)


def _engine_jobs(
    levels: Sequence[Ilc20Level],
    prepared: Sequence[PreparedLevel],
    maps: Mapping[str, GridMap],
    options: EvaluationOptions,
    engine: Engine,
) -> list[EngineJob]:
    work: list[EngineJob] = []
    for level, ready in zip(levels, prepared, strict=True):
        if level.name not in maps:
            continue
        # with the building as the prior, all its evaluated levels are on offer
        offered = [other.name for other in levels if other.site == level.site and other.name in maps]
        names = offered if options.scenario is Scenario.VENUE else [level.name]
        own_maps = {name: maps[name] for name in names}
        for walks in _chunks(_test_walks(level, options), WALKS_A_JOB):
            job = _job(level, level.name, level.site, walks, ready, options)
            work.append(
                EngineJob(job, own_maps, options.method, options.parameters, engine.create_tracker, engine.smoother)
            )
    return work


def _through_http(
    levels: Sequence[Ilc20Level], options: EvaluationOptions, engine: Engine, transport: Transport, say: Progress
) -> _Run:
    tasks = [
        PrepareTask(level.name, _survey_walks(level, options), options.map_settings, with_map=False) for level in levels
    ]
    if options.scenario is Scenario.VENUE:
        note = "a session of the service is opened on one level: walks of an unknown level cannot be sent"
        return _Run((), (), {}, notes=(note,))
    ids: dict[str, str] = {}
    rasters: dict[str, FieldRaster] = {}
    for number, (level, task) in enumerate(zip(levels, tasks, strict=True)):
        share = _part(say, 0.4 * number / len(levels), 0.4 * (number + 1) / len(levels), level.name)
        ids[level.name] = _send_survey(level, task, transport, share)
        raster = transport.field_raster(ids[level.name]) if options.plots else None
        if raster:
            rasters[level.name] = raster
    prepared = [engine.prepare(task) for task in tasks]
    driver = HttpDriver(transport, options.method, options.parameters)
    baseline = HttpDriver(transport, BASELINE, {})
    jobs = [
        _job(level, ids[level.name], transport.venue_of(ids[level.name]), (walk,), ready, options)
        for level, ready in zip(levels, prepared, strict=True)
        for walk in _test_walks(level, options)
    ]
    with ThreadPoolExecutor(options.jobs) as pool:
        results = map_tasks(
            pool,
            lambda job: replay_walks(job, driver, baseline),
            jobs,
            lambda done, n: say(0.4 + 0.45 * done / n, f"walk {done} of {n}"),
        )
    notes = (
        ("whether the service used the Wi-Fi readings cannot be seen from outside",)
        if options.aids is Aids.WIFI
        else ()
    )
    return _Run(tuple(r for part in results for r in part), prepared, rasters, notes=notes)


def _send_survey(level: Ilc20Level, task: PrepareTask, transport: Transport, say: Progress) -> str:
    image = level.plan_png_path
    level_id = transport.add_level(
        LevelUpload(
            site=level.site,
            name=level.floor,
            ordinal=level.ordinal,
            extent=level.extent,
            plan_png=image.read_bytes() if image else None,
            vector_plan=level.vector_plan,
        )
    )
    transport.add_walks(level_id, task.walks, lambda f, what: say(0.6 * f, what))
    transport.build_map(level_id, task.settings, lambda f, what: say(0.6 + 0.4 * f, what))
    return level_id


def _report(options: EvaluationOptions, levels: Sequence[Ilc20Level], run: _Run) -> Report:
    through_engine = options.through is Through.ENGINE
    unmapped = [Dropped(p.name, "", f"no map: {p.problem}") for p in run.prepared if through_engine and not p.grid_map]
    return Report(
        set_name=SET_NAME,
        scenario=options.scenario,
        aids=options.aids,
        through=options.through,
        method=options.method,
        levels=tuple(level.name for level in levels),
        walks=tuple(r for r in run.results if isinstance(r, WalkResult)),
        dropped=(*unmapped, *(r for r in run.results if isinstance(r, Dropped))),
        maps={p.name: MapNote(p.n_walks, p.build_s) for p in run.prepared},
        aids_used=False if options.aids is Aids.NONE else run.aids_used,
        notes=(*run.notes, *_failures(run.results)),
    )


def _failures(results: Results) -> tuple[str, ...]:
    """A run must not pass over segments that failed."""
    failures = [failure for result in results if isinstance(result, WalkResult) for failure in result.failures]
    return (f"{len(failures)} failures; the first: {failures[0]}",) if failures else ()


def _survey_walks(level: Ilc20Level, options: EvaluationOptions) -> tuple[SurveyWalk, ...]:
    walks = [walk.survey_walk() for walk in level.walks("train")]
    return tuple(walks if options.aids is Aids.WIFI else [replace(walk, wifi=None) for walk in walks])


def _test_walks(level: Ilc20Level, options: EvaluationOptions) -> tuple[RecordedWalk, ...]:
    return level.walks("test")[: options.limit]


def _job(
    level: Ilc20Level,
    level_id: str,
    venue_id: str,
    walks: tuple[RecordedWalk, ...],
    ready: PreparedLevel,
    options: EvaluationOptions,
) -> Job:
    return Job(level.name, level_id, venue_id, walks, ready.area, options.scenario, options.aids, options.repeat)


def _chunks(items: tuple[T, ...], size: int) -> Iterator[tuple[T, ...]]:
    for start in range(0, len(items), size):
        yield items[start : start + size]


def _walks_done(done: int, work: Sequence[EngineJob]) -> str:
    total = sum(len(one.job.walks) for one in work)
    return f"walk {round(total * done / len(work))} of {total}"


def _part(say: Progress, start: float, end: float, name: str) -> Progress:
    return lambda fraction, what: say(start + (end - start) * fraction, f"{name}: {what}")


def _silent(_fraction: float, _what: str) -> None:
    return
