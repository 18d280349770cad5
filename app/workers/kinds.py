"""How each kind of job is done: what the lanes need, from the use cases and the tasks."""

from __future__ import annotations

from datetime import UTC, datetime

from app.services.ports import Executor
from app.services.processing import ProcessingService
from app.services.records import Job, JobKind
from app.services.tasks import (
    BuildResult,
    BuildSpec,
    BuildTask,
    ContributeResult,
    ContributeSpec,
    ContributeTask,
    LocateResult,
    LocateSpec,
    LocateTask,
)
from app.telemetry import Metrics
from app.workers.runner import Work


def segment_work(
    processing: ProcessingService, executor: Executor, task: LocateTask, *, capacity: int, metrics: Metrics
) -> Work[LocateSpec, LocateResult]:
    """Segments of sessions: short and many; a worker that holds the session's map gets it."""

    def complete(job: Job, result: LocateResult) -> Job | None:
        done = processing.complete_locate(job, result)
        if done is not None:
            metrics.work_seconds.labels(job.kind).observe(result.cpu_s)
            for fix in result.fixes:
                metrics.fixes.labels(fix.status).inc()
        return done

    return Work(
        kind=JobKind.LOCATE_SEGMENT,
        executor=executor,
        capacity=capacity,
        task=task,
        prepare=processing.locate_spec,
        complete=complete,
        affinity=lambda spec: spec.maps[0].hash if spec.maps else "",
    )


def contribute_work(
    processing: ProcessingService, executor: Executor, task: ContributeTask, *, capacity: int, metrics: Metrics
) -> Work[ContributeSpec, ContributeResult]:
    """What sessions offer to maps: a few tenths of a second each, done by the workers of segments between these."""

    def complete(job: Job, result: ContributeResult) -> Job | None:
        metrics.work_seconds.labels(job.kind).observe(result.cpu_s)
        return processing.complete_contribute(job, result)

    return Work(
        kind=JobKind.CONTRIBUTE,
        executor=executor,
        capacity=capacity,
        task=task,
        prepare=processing.contribute_spec,
        complete=complete,
        affinity=lambda spec: spec.smooth.maps[0].hash if spec.smooth.maps else "",
    )


def build_work(
    processing: ProcessingService, executor: Executor, task: BuildTask, *, capacity: int, metrics: Metrics
) -> Work[BuildSpec, BuildResult]:
    """Map builds: long and few, and watched."""

    def complete(job: Job, result: BuildResult) -> Job | None:
        started = job.started_at or job.created_at
        done = processing.complete_build(job, result, (datetime.now(UTC) - started).total_seconds())
        metrics.work_seconds.labels(job.kind).observe(result.cpu_s)
        return done

    return Work(
        kind=JobKind.BUILD_MAP,
        executor=executor,
        capacity=capacity,
        task=task,
        prepare=processing.build_spec,
        complete=complete,
        affinity=lambda spec: spec.level_id,
        shows_progress=True,
    )
