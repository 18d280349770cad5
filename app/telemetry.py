"""Logs and metrics of the service process.

Logs go to stderr through structlog; what looks like a credential is masked in the last step, whatever library
wrote it. Every metric stands in :data:`METRICS` and in ``docs/metrics.md``; a test keeps the two in step.
"""

from __future__ import annotations

import logging
import re
import sys
from collections.abc import Mapping, MutableMapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import structlog
from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, ProcessCollector, generate_latest
from prometheus_client.exposition import CONTENT_TYPE_LATEST

from app.services.records import Job, JobState
from app.settings import LogLevel

METRICS_CONTENT_TYPE = CONTENT_TYPE_LATEST

_SECRET_NAMES = frozenset({"authorization", "x-api-key", "api_key", "apikey", "secret", "password", "cookie", "token"})
_SECRET_VALUE = re.compile(r"is[ik]_[\w-]+|whsec_[\w-]+|(?i:bearer\s+)[\w.~+/-]+=*")
_MASK = "***"


def mask(value: object, name: str = "") -> object:
    """Return ``value`` with credentials masked: by the name it stands under, and by what it looks like."""
    if name.lower() in _SECRET_NAMES:
        return _MASK
    if isinstance(value, str):
        return _SECRET_VALUE.sub(_MASK, value)
    if isinstance(value, bytes):
        return mask(value.decode("latin-1"))
    if isinstance(value, Mapping):
        return {key: mask(item, str(key)) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [mask(item) for item in value]
    return value


def _mask_event(_: object, __: str, event: MutableMapping[str, Any]) -> MutableMapping[str, Any]:
    # Objects are rendered with repr later on, where nothing would be masked any more: render them here.
    plain = (str, bytes, Mapping, list, tuple, int, float, bool, type(None))
    event.pop("color_message", None)  # uvicorn's message a second time
    for name, value in event.items():
        if not name.startswith("_"):
            event[name] = mask(value if isinstance(value, plain) else repr(value), name)
    return event


def configure_logging(level: LogLevel, *, as_json: bool) -> None:
    """Send structlog's and the standard library's logs to stderr in one format."""
    shared: list[structlog.typing.Processor] = [
        structlog.contextvars.merge_contextvars,
        structlog.stdlib.add_log_level,
        structlog.stdlib.add_logger_name,
        structlog.processors.TimeStamper(fmt="iso", utc=True),
    ]
    renderer: structlog.typing.Processor = structlog.processors.JSONRenderer()
    if not as_json:
        renderer = structlog.dev.ConsoleRenderer(
            colors=sys.stderr.isatty(), exception_formatter=structlog.dev.plain_traceback
        )
    formatter = structlog.stdlib.ProcessorFormatter(
        foreign_pre_chain=[*shared, structlog.stdlib.ExtraAdder()],
        processors=[
            structlog.stdlib.ProcessorFormatter.remove_processors_meta,
            structlog.stdlib.PositionalArgumentsFormatter(),
            structlog.processors.format_exc_info,
            _mask_event,
            renderer,
        ],
    )
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(formatter)
    root = logging.getLogger()
    root.handlers[:] = [handler]
    root.setLevel(level.upper())
    # Says at every start that there is nothing to migrate.
    logging.getLogger("alembic").setLevel(logging.WARNING)
    structlog.configure(
        processors=[
            structlog.stdlib.filter_by_level,
            *shared,
            structlog.stdlib.ProcessorFormatter.wrap_for_formatter,
        ],
        logger_factory=structlog.stdlib.LoggerFactory(),
        wrapper_class=structlog.stdlib.BoundLogger,
        cache_logger_on_first_use=False,
    )


class MetricKind(StrEnum):
    """Prometheus type of a metric."""

    COUNTER = "counter"
    GAUGE = "gauge"
    HISTOGRAM = "histogram"


@dataclass(frozen=True, slots=True)
class Metric:
    """One row of the table of metrics."""

    name: str
    kind: MetricKind
    labels: tuple[str, ...]
    help: str
    buckets: tuple[float, ...] = ()


_REQUEST_BUCKETS = (0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0, 30.0)
_JOB_BUCKETS = (0.005, 0.01, 0.02, 0.03, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 15.0, 60.0, 300.0)
_WORK_BUCKETS = (0.001, 0.002, 0.005, 0.01, 0.015, 0.02, 0.03, 0.05, 0.1, 0.5, 2.0, 10.0, 60.0, 300.0)

HTTP_REQUESTS = Metric(
    "isodyn_http_requests_total", MetricKind.COUNTER, ("method", "route", "status"), "Requests answered."
)
HTTP_SECONDS = Metric(
    "isodyn_http_request_seconds",
    MetricKind.HISTOGRAM,
    ("method", "route"),
    "Time from a request's first byte to its answer.",
    _REQUEST_BUCKETS,
)
JOBS_QUEUED = Metric("isodyn_jobs_queued_total", MetricKind.COUNTER, ("kind",), "Jobs accepted.")
JOBS_FINISHED = Metric(
    "isodyn_jobs_finished_total", MetricKind.COUNTER, ("kind", "state"), "Jobs that reached a final state."
)
JOBS_RETRIED = Metric(
    "isodyn_jobs_retried_total", MetricKind.COUNTER, ("kind",), "Jobs queued again because their worker was lost."
)
JOBS_RUNNING = Metric("isodyn_jobs_running", MetricKind.GAUGE, ("kind",), "Jobs handed to the pool and not yet back.")
JOB_SECONDS = Metric(
    "isodyn_job_seconds", MetricKind.HISTOGRAM, ("kind",), "Time from acceptance of a job to its end.", _JOB_BUCKETS
)
WORK_SECONDS = Metric(
    "isodyn_work_seconds", MetricKind.HISTOGRAM, ("kind",), "Processor time a worker spent on a job.", _WORK_BUCKETS
)
FIXES = Metric("isodyn_fixes_total", MetricKind.COUNTER, ("status",), "Fixes computed for sessions.")
WORKERS = Metric("isodyn_workers", MetricKind.GAUGE, (), "Workers that are ready for segments.")
WORKERS_LOST = Metric(
    "isodyn_workers_lost_total", MetricKind.COUNTER, (), "Worker processes that died and were replaced."
)
RUNNER_ERRORS = Metric(
    "isodyn_runner_errors_total", MetricKind.COUNTER, (), "Unexpected errors met by the job runner (each is logged)."
)
WEBHOOK_ATTEMPTS = Metric(
    "isodyn_webhook_attempts_total", MetricKind.COUNTER, ("outcome",), "Messages sent to webhooks, by what came of it."
)
WEBHOOK_SECONDS = Metric(
    "isodyn_webhook_seconds",
    MetricKind.HISTOGRAM,
    (),
    "Time a webhook took to answer, or to fail.",
    _REQUEST_BUCKETS,
)
WEBHOOK_ERRORS = Metric(
    "isodyn_webhook_errors_total",
    MetricKind.COUNTER,
    (),
    "Errors of the service met while sending to webhooks (each is logged).",
)

METRICS = (
    HTTP_REQUESTS,
    HTTP_SECONDS,
    JOBS_QUEUED,
    JOBS_FINISHED,
    JOBS_RETRIED,
    JOBS_RUNNING,
    JOB_SECONDS,
    WORK_SECONDS,
    FIXES,
    WORKERS,
    WORKERS_LOST,
    RUNNER_ERRORS,
    WEBHOOK_ATTEMPTS,
    WEBHOOK_SECONDS,
    WEBHOOK_ERRORS,
)


class Metrics:
    """The metrics of one service, in a registry of their own.

    It is also a job listener, so that it counts jobs wherever they end.
    """

    def __init__(self) -> None:
        self.registry = CollectorRegistry()
        ProcessCollector(registry=self.registry)
        self.http_requests = self._counter(HTTP_REQUESTS)
        self.http_seconds = self._histogram(HTTP_SECONDS)
        self.jobs_queued = self._counter(JOBS_QUEUED)
        self.jobs_finished = self._counter(JOBS_FINISHED)
        self.jobs_retried = self._counter(JOBS_RETRIED)
        self.jobs_running = self._gauge(JOBS_RUNNING)
        self.job_seconds = self._histogram(JOB_SECONDS)
        self.work_seconds = self._histogram(WORK_SECONDS)
        self.fixes = self._counter(FIXES)
        self.workers = self._gauge(WORKERS)
        self.workers_lost = self._counter(WORKERS_LOST)
        self.runner_errors = self._counter(RUNNER_ERRORS)
        self.webhook_attempts = self._counter(WEBHOOK_ATTEMPTS)
        self.webhook_seconds = self._histogram(WEBHOOK_SECONDS)
        self.webhook_errors = self._counter(WEBHOOK_ERRORS)

    def observe_request(self, method: str, route: str, status: int, seconds: float) -> None:
        """Count an answered request; ``route`` is the template (``/v1/maps/{id}``), never the path."""
        self.http_requests.labels(method, route, str(status)).inc()
        self.http_seconds.labels(method, route).observe(seconds)

    def job_queued(self, job: Job) -> None:
        """Count an accepted job."""
        self.jobs_queued.labels(job.kind).inc()

    def job_finished(self, job: Job) -> None:
        """Count a job that ended; only jobs that were done tell about time."""
        self.jobs_finished.labels(job.kind, job.state).inc()
        if job.state is JobState.DONE and job.finished_at is not None:
            self.job_seconds.labels(job.kind).observe((job.finished_at - job.created_at).total_seconds())

    def render(self) -> bytes:
        """Return all metrics in the Prometheus text format."""
        return generate_latest(self.registry)

    def _counter(self, metric: Metric) -> Counter:
        return Counter(metric.name, metric.help, metric.labels, registry=self.registry)

    def _gauge(self, metric: Metric) -> Gauge:
        return Gauge(metric.name, metric.help, metric.labels, registry=self.registry)

    def _histogram(self, metric: Metric) -> Histogram:
        return Histogram(metric.name, metric.help, metric.labels, registry=self.registry, buckets=metric.buckets)
