"""Composition root of the service: builds every part, starts and stops them in order, and serves HTTP."""

from __future__ import annotations

import fcntl
import sys
from collections.abc import AsyncIterator, Iterator, Mapping
from contextlib import ExitStack, asynccontextmanager, contextmanager
from datetime import timedelta
from pathlib import Path
from types import FrameType

import structlog
import uvicorn
from fastapi import FastAPI
from starlette.concurrency import run_in_threadpool

from app.api import create_api
from app.api.checks import Checks
from app.dashboard import router as dashboard
from app.services.clock import utc_now
from app.services.container import build_services
from app.services.tasks import LocateTask
from app.services.webhook_outbox import RetryPolicy
from app.settings import PoolKind, Settings
from app.storage.checkpoints import FileCheckpoints
from app.storage.database import Database
from app.storage.host import LocalHost
from app.storage.map_cache import FileMapCache, open_map
from app.telemetry import Metrics, configure_logging
from app.workers.bootstrap import warm_up, worker_context
from app.workers.broker import JobBroker
from app.workers.events import JobEvents
from app.workers.kinds import build_work, contribute_work, segment_work
from app.workers.live import SessionHub
from app.workers.periodic import Periodic
from app.workers.pools import InlineExecutor, ThreadExecutor
from app.workers.processes import ProcessExecutor
from app.workers.runner import JobRunner, Lane
from app.workers.tasks import BuildMap, ContributeSession, LocateSegment, ReplaySession, SmoothSession
from app.workers.webhook_dispatcher import WebhookDispatcher
from app.workers.webhook_sender import WebhookSender

Pool = InlineExecutor | ThreadExecutor | ProcessExecutor

_SPARE_JOBS = 2
"""Jobs with a pool beyond its workers, so that a worker finds the next one at once."""
_SWEEP_S = 5.0
"""How often recordings that fell silent are looked for."""
_ABANDON_S = 5.0
"""How long threads may take to notice that their workers are gone."""
_BANNER = """
=== Isodyn: first start =========================================================
Admin key, shown only this once:

    {secret}

Send it as "Authorization: Bearer <key>"; make lesser keys with POST /v1/keys.
=================================================================================
"""

_log = structlog.stdlib.get_logger("app.main")


class DataDirInUseError(Exception):
    """Another service works in this data directory; two would do each other's jobs."""


@contextmanager
def claim_data_dir(folder: Path) -> Iterator[None]:
    """Hold the folder for this process; the claim ends with the process, however that ends."""
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "service.lock").open("w") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            message = f"another service runs in {folder.resolve()}; give this one a data_dir of its own"
            raise DataDirInUseError(message) from error
        yield


class Application:
    """All parts of one service process, and the order in which they start and stop."""

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self.metrics = Metrics()
        self.broker = JobBroker()
        self.hub = SessionHub()
        self.database = Database.at(settings.database_path, power_safe=settings.power_safe)
        self.segment_pool = self._make_pool(settings.workers, settings.segment_time_limit_s)
        self.build_pool = self._make_pool(1, settings.build_time_limit_s)
        events = JobEvents()
        locate = LocateSegment(open_map, settings.maps_per_worker)
        self.services = build_services(
            uow=self.database,
            clock=utc_now,
            executor=self.segment_pool,
            cache=FileMapCache(settings.map_cache_dir, max_bytes=settings.map_cache_bytes),
            listener=events,
            watchers=self.hub,
            checks=Checks(),
            locate_task=locate,
            smooth_task=SmoothSession(open_map, settings.maps_per_worker),
            replay_task=ReplaySession(open_map, settings.maps_per_worker),
            max_queued=settings.max_queued_jobs,
            host=LocalHost(
                settings.database_path,
                settings.map_cache_dir,
                alive=lambda: self.segment_pool.alive,
                wanted=settings.workers,
            ),
            webhook_private_networks=settings.webhook_private_networks,
            webhook_retries=RetryPolicy(give_up_s=settings.webhook_give_up_s),
        )
        self.webhooks = WebhookDispatcher(self.services.outbox, self._open_sender, self.metrics)
        self.runner = self._make_runner(events, locate)
        # The broker first: someone waits there.
        for listener in (self.broker, self.hub, self.runner, self.webhooks, self.metrics):
            events.add(listener)
        silence = timedelta(seconds=settings.recording_silence_s)
        self.sweeper = Periodic("recordings", _SWEEP_S, lambda: self.services.recordings.close_silent(silence))
        self._stack = ExitStack()
        self.metrics.workers.set_function(lambda: self.segment_pool.alive)

    def start(self) -> None:
        """Start everything; requests may come at once, they wait for workers in the queue."""
        with ExitStack() as stack:
            stack.enter_context(claim_data_dir(self.settings.data_dir))
            stack.callback(self.database.close)
            self.database.migrate()
            _show_once(self.services.accounts.ensure_admin_key())
            recovered = self.services.processing.recover()
            stack.callback(self.webhooks.stop, self.settings.shutdown_grace_s)
            self.webhooks.start()
            stack.callback(self.runner.join, _ABANDON_S)
            for pool in (self.segment_pool, self.build_pool):
                stack.callback(pool.close)
                pool.start()
            self.runner.start()
            stack.callback(self._drain)
            self.sweeper.start()
            stack.callback(self.sweeper.stop)
            self._stack = stack.pop_all()
        _log.info(
            "service started",
            data_dir=str(self.settings.data_dir.resolve()),
            pool=self.settings.pool.value,
            workers=self.settings.workers,
            recovered_jobs=recovered,
        )

    def stop(self) -> None:
        """Stop everything, in reverse; jobs that cannot be finished in time are done after the next start."""
        self._stack.close()
        _log.info("service stopped")

    def ready(self) -> Mapping[str, bool]:
        """Whether each part can do its work now."""
        return {"database": self.database.ping(), "pool": self.segment_pool.alive > 0}

    @asynccontextmanager
    async def lifespan(self, _: FastAPI) -> AsyncIterator[None]:
        """Run everything while the application serves."""
        await run_in_threadpool(self.start)
        try:
            yield
        finally:
            await run_in_threadpool(self.stop)

    def api(self) -> FastAPI:
        """The HTTP application over these parts; its lifespan starts and stops them."""
        return create_api(
            services=self.services,
            broker=self.broker,
            hub=self.hub,
            settings=self.settings,
            metrics=self.metrics,
            ready=self.ready,
            lifespan=self.lifespan,
            pages=(dashboard,),
        )

    def _drain(self) -> None:
        if not self.runner.stop(self.settings.shutdown_grace_s):
            _log.warning("some jobs did not end in time; they are done after the next start")

    def _open_sender(self) -> WebhookSender:
        settings = self.settings
        return WebhookSender(private_networks=settings.webhook_private_networks, timeout_s=settings.webhook_timeout_s)

    def _make_pool(self, workers: int, time_limit_s: float) -> Pool:
        if self.settings.pool is PoolKind.INLINE:
            return InlineExecutor()
        if self.settings.pool is PoolKind.THREADS:
            return ThreadExecutor(workers, warm_up=warm_up)
        return ProcessExecutor(
            workers,
            worker_context(self.settings.kernel_cache_dir),
            warm_up=warm_up,
            time_limit_s=time_limit_s,
            start_timeout_s=self.settings.worker_start_timeout_s,
            on_lost=self.metrics.workers_lost.inc,
        )

    def _make_runner(self, events: JobEvents, locate: LocateTask) -> JobRunner:
        processing, metrics = self.services.processing, self.metrics
        capacity = self.settings.workers + _SPARE_JOBS
        segments = segment_work(processing, self.segment_pool, locate, capacity=capacity, metrics=metrics)
        build = BuildMap(open_map, FileCheckpoints(self.settings.checkpoint_dir))
        builds = build_work(processing, self.build_pool, build, capacity=1, metrics=metrics)
        offers = contribute_work(
            processing,
            self.segment_pool,
            ContributeSession(open_map, self.settings.maps_per_worker),
            capacity=self.settings.workers,
            metrics=metrics,
        )
        return JobRunner(
            {
                offers.kind: Lane(offers, processing=processing, listener=events, metrics=metrics),
                segments.kind: Lane(segments, processing=processing, listener=events, metrics=metrics),
                builds.kind: Lane(builds, processing=processing, listener=events, metrics=metrics),
            }
        )


def create_app(settings: Settings) -> FastAPI:
    """Build the service; nothing runs until the application's lifespan begins."""
    return Application(settings).api()


def serve(settings: Settings) -> None:
    """Serve until SIGINT or SIGTERM: then answer what is open, finish what runs, and return.

    One process serves HTTP; the numerics have processes of their own.
    """
    configure_logging(settings.log_level, as_json=settings.log_json)
    application = Application(settings)
    config = uvicorn.Config(
        application.api(),
        host=settings.host,
        port=settings.port,
        log_config=None,
        access_log=False,
        server_header=False,
        ws="websockets-sansio",
        ws_max_size=settings.max_body_bytes,
        # Requests that wait for a result are answered by what is still running.
        timeout_graceful_shutdown=max(1, round(settings.shutdown_grace_s)),
    )
    _Server(config, application.hub).run()


class _Server(uvicorn.Server):
    """Ends open streams when it is told to stop: uvicorn waits for them before it ends the application."""

    def __init__(self, config: uvicorn.Config, hub: SessionHub) -> None:
        super().__init__(config)
        self._hub = hub

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        """Stop."""
        self._hub.close()
        super().handle_exit(sig, frame)


def _show_once(secret: str | None) -> None:
    """Show a fresh admin key to whoever started the service: on stdout, never in a log."""
    if secret is not None:
        sys.stdout.write(_BANNER.format(secret=secret))
        sys.stdout.flush()


if __name__ == "__main__":
    serve(Settings())
