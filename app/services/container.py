"""All use cases, wired once per process by a composition root."""

from __future__ import annotations

from dataclasses import dataclass

from app.services.accounts import AccountService
from app.services.activity import Host
from app.services.alarms import AlarmService
from app.services.clock import Clock
from app.services.contributions import ContributionService
from app.services.device_models import DeviceModelService
from app.services.devices import DeviceService
from app.services.exchange import ExchangeService
from app.services.geofences import GeofenceService
from app.services.ground_truth import GroundTruthService
from app.services.idempotency import IdempotencyService
from app.services.ingest.ports import UploadChecks
from app.services.ingest.recordings import RecordingService
from app.services.ingest.tokens import IngestTokenService
from app.services.jobs import JobService
from app.services.live import LiveService, SessionListener
from app.services.locate import LocateService
from app.services.maps import MapService
from app.services.methods import MethodCheck, check_method
from app.services.planning import PlanningService
from app.services.ports import Executor, JobListener, MapCache, UnitOfWorkFactory
from app.services.processing import ProcessingService
from app.services.replays import ReplayService
from app.services.search import SearchService
from app.services.session_samples import SessionSamplesService
from app.services.sessions import SessionService
from app.services.stats import StatsService
from app.services.surveys import SurveyService
from app.services.tasks import LocateTask, ReplayTask, SmoothTask
from app.services.tracks import TrackService
from app.services.trajectories import TrajectoryService
from app.services.venues import VenueService
from app.services.versions import VersionService
from app.services.webhook_outbox import OutboxService, RetryPolicy
from app.services.webhooks import WebhookService

DEFAULT_MAX_QUEUED = 10_000


@dataclass(frozen=True, slots=True)
class Services:
    """The use cases of one process."""

    venues: VenueService
    search: SearchService
    devices: DeviceService
    device_models: DeviceModelService
    surveys: SurveyService
    maps: MapService
    contributions: ContributionService
    versions: VersionService
    planning: PlanningService
    sessions: SessionService
    live: LiveService
    ingest_tokens: IngestTokenService
    recordings: RecordingService
    locate: LocateService
    trajectories: TrajectoryService
    tracks: TrackService
    session_samples: SessionSamplesService
    replays: ReplayService
    jobs: JobService
    processing: ProcessingService
    accounts: AccountService
    idempotency: IdempotencyService
    stats: StatsService
    ground_truth: GroundTruthService
    alarms: AlarmService
    exchange: ExchangeService
    geofences: GeofenceService
    webhooks: WebhookService
    outbox: OutboxService


def build_services(
    *,
    uow: UnitOfWorkFactory,
    clock: Clock,
    executor: Executor,
    cache: MapCache,
    listener: JobListener,
    watchers: SessionListener,
    checks: UploadChecks,
    locate_task: LocateTask,
    smooth_task: SmoothTask,
    replay_task: ReplayTask,
    max_queued: int = DEFAULT_MAX_QUEUED,
    check: MethodCheck = check_method,
    host: Host | None = None,
    webhook_private_networks: bool = False,
    webhook_retries: RetryPolicy | None = None,
) -> Services:
    """Wire the use cases.

    ``locate_task`` is what workers run for a one-shot location, ``smooth_task`` for a smoothed trajectory,
    ``replay_task`` for a replay (``app.workers.tasks``): the use cases know that they exist, not where they live.
    Without a ``host`` nobody looks after disk and workers.
    """
    maps = MapService(uow=uow, clock=clock, cache=cache, listener=listener)
    trajectories = TrajectoryService(uow=uow, clock=clock, executor=executor, cache=cache, task=smooth_task)
    return Services(
        venues=VenueService(uow=uow, clock=clock),
        search=SearchService(uow=uow, clock=clock),
        devices=DeviceService(uow=uow, clock=clock),
        device_models=DeviceModelService(uow=uow, clock=clock),
        surveys=SurveyService(uow=uow, clock=clock),
        contributions=ContributionService(uow=uow, clock=clock, listener=listener),
        versions=VersionService(uow=uow, clock=clock, cache=cache),
        maps=maps,
        planning=PlanningService(uow=uow, clock=clock, maps=maps),
        sessions=SessionService(
            uow=uow,
            clock=clock,
            cache=cache,
            listener=listener,
            watchers=watchers,
            max_queued=max_queued,
            check=check,
        ),
        live=LiveService(uow=uow, clock=clock),
        ingest_tokens=IngestTokenService(uow=uow, clock=clock),
        recordings=RecordingService(
            uow=uow, clock=clock, checks=checks, listener=listener, watchers=watchers, max_queued=max_queued
        ),
        locate=LocateService(uow=uow, clock=clock, executor=executor, cache=cache, task=locate_task, check=check),
        trajectories=trajectories,
        tracks=TrackService(uow=uow, clock=clock, trajectories=trajectories),
        session_samples=SessionSamplesService(uow=uow, clock=clock, cache=cache),
        replays=ReplayService(uow=uow, clock=clock, executor=executor, cache=cache, task=replay_task),
        jobs=JobService(uow=uow, clock=clock, listener=listener),
        processing=ProcessingService(uow=uow, clock=clock, cache=cache),
        accounts=AccountService(uow=uow, clock=clock),
        idempotency=IdempotencyService(uow=uow, clock=clock),
        stats=StatsService(uow=uow, clock=clock, host=host),
        ground_truth=GroundTruthService(uow=uow, clock=clock),
        alarms=AlarmService(uow=uow, clock=clock, host=host),
        exchange=ExchangeService(uow=uow, clock=clock, cache=cache),
        geofences=GeofenceService(uow=uow, clock=clock),
        webhooks=WebhookService(uow=uow, clock=clock, private_networks=webhook_private_networks),
        outbox=OutboxService(uow=uow, clock=clock, policy=webhook_retries),
    )
