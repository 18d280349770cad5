"""Runs that send everything through a running service."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from app.engine.types import Fix, ImuSamples, Progress, RadioScans, Segment
from app.evaluation.datasets.ilc20 import Ilc20Level
from app.evaluation.datasets.walks import RecordedWalk
from app.evaluation.drivers import FieldRaster, HttpDriver, LevelUpload, Transport
from app.evaluation.levels import LevelsOfRun, Outcome, prepare_task, replay_job, walks_to_replay
from app.evaluation.pool import map_tasks
from app.evaluation.prepare import PrepareTask
from app.evaluation.protocol import Aids, EvaluationOptions, make_trip
from app.evaluation.replay import Job, replay_walks
from app.evaluation.results import BASELINE
from app.evaluation.through_engine import WALKS_TO_ASK_FOR_AIDS, Engine

ONE_SHOT_S = 30.0
"""How much of a walk is located at once to see whether aids change the answer."""


def run_through_http(
    levels: LevelsOfRun, options: EvaluationOptions, engine: Engine, transport: Transport, say: Progress
) -> Outcome:
    """Send levels and surveys, have all maps built, then replay the walks in ``options.jobs`` threads."""
    tasks = {level.name: prepare_task(level, options, with_map=False) for level in levels.mapped}
    ids, rasters = _send_levels(levels.mapped, tasks, options, transport, say)
    prepared = {level.name: engine.prepare(tasks[level.name]) for level in levels.mapped}
    jobs = [
        replay_job(level, ids[level.name], (walk,), prepared[level.name], options)
        for level in levels.evaluated
        for walk in walks_to_replay(level, options)
    ]
    driver = HttpDriver(transport, options.method, options.parameters)
    baseline = HttpDriver(transport, BASELINE, {})
    with ThreadPoolExecutor(options.jobs) as pool:
        results = map_tasks(
            pool,
            lambda job: replay_walks(job, driver, baseline),
            jobs,
            lambda done, n: say(0.4 + 0.45 * done / n, f"walk {done} of {n}"),
        )
    used = _aids_are_used(jobs, options, transport) if options.aids else None
    return Outcome(tuple(r for part in results for r in part), tuple(prepared.values()), rasters, used)


def _send_levels(
    levels: Sequence[Ilc20Level],
    tasks: Mapping[str, PrepareTask],
    options: EvaluationOptions,
    transport: Transport,
    say: Progress,
) -> tuple[dict[str, tuple[str, str]], dict[str, FieldRaster]]:
    """Ids of each level and its venue, and its field if it is to be drawn."""
    ids: dict[str, tuple[str, str]] = {}
    rasters: dict[str, FieldRaster] = {}
    for number, level in enumerate(levels):
        share = _part(say, 0.4 * number / len(levels), 0.4 * (number + 1) / len(levels), level.name)
        level_id = _send_survey(level, tasks[level.name], transport, share)
        ids[level.name] = (level_id, transport.venue_of(level_id))
        raster = transport.field_raster(level_id) if options.plots else None
        if raster:
            rasters[level.name] = raster
    return ids, rasters


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


def _aids_are_used(jobs: Sequence[Job], options: EvaluationOptions, transport: Transport) -> bool:
    """Whether the service's answers change with the readings.

    Asked of one-shot location: unlike sessions, whose seeds differ, it answers the same request in the same way.
    """
    asked = [(job, walk) for job in jobs[:WALKS_TO_ASK_FOR_AIDS] for walk in job.walks]
    return any(_answers_differ(job, walk, options, transport) for job, walk in asked)


def _answers_differ(job: Job, walk: RecordedWalk, options: EvaluationOptions, transport: Transport) -> bool:
    answers: list[Sequence[Fix]] = []
    for aids in (Aids(), options.aids):
        trip = make_trip(walk, job.level_id, job.scenario, venue_id=job.venue_id, aids=aids, repeat=job.repeat)
        if not trip.segments:
            return False
        first = [s for s in trip.segments if s.samples.t[-1] - trip.start_t <= ONE_SHOT_S] or list(trip.segments[:1])
        answers.append(
            transport.locate(
                trip.prior, trip.venue_id, joined(first), method=options.method, parameters=options.parameters
            )
        )
    return answers[0] != answers[1]


def joined(segments: Sequence[Segment]) -> Segment:
    """Samples and radio readings of several segments as one."""
    names = ("t", "mag", "acc", "gyro")
    samples = ImuSamples(*(np.concatenate([getattr(one.samples, name) for one in segments]) for name in names))
    return Segment(samples, wifi=_all([one.wifi for one in segments]), ble=_all([one.ble for one in segments]))


def _all(parts: Sequence[RadioScans | None]) -> RadioScans | None:
    heard = [part for part in parts if part is not None]
    if not heard:
        return None
    address = tuple(name for part in heard for name in part.address)
    return RadioScans(np.concatenate([p.t for p in heard]), address, np.concatenate([p.rssi for p in heard]))


def _part(say: Progress, start: float, end: float, name: str) -> Progress:
    return lambda fraction, what: say(start + (end - start) * fraction, f"{name}: {what}")
