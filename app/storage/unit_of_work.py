"""One transaction with its repositories."""

from __future__ import annotations

from sqlalchemy import Connection

from app.services.activity import ActivityRepository, InventoryRepository
from app.services.geofence_ports import GeofenceRepository
from app.services.ground_truth_records import GroundTruthRepository
from app.services.ingest.ports import IngestRepository
from app.services.ports import (
    ContributionRepository,
    DeviceModelRepository,
    DeviceRepository,
    IdempotencyRepository,
    JobRepository,
    KeyRepository,
    LevelRepository,
    MapRepository,
    PublicationRepository,
    SessionRepository,
    SurveyRepository,
    VenueRepository,
)
from app.services.records import Stats
from app.services.webhook_ports import WebhookRepository
from app.storage.repositories.activity import SqlActivityRepository
from app.storage.repositories.contributions import SqlContributionRepository
from app.storage.repositories.device_models import SqlDeviceModelRepository
from app.storage.repositories.devices import SqlDeviceRepository
from app.storage.repositories.geofences import SqlGeofenceRepository
from app.storage.repositories.ground_truth import SqlGroundTruthRepository
from app.storage.repositories.idempotency import SqlIdempotencyRepository
from app.storage.repositories.ingest import SqlIngestRepository
from app.storage.repositories.inventory import SqlInventoryRepository
from app.storage.repositories.jobs import SqlJobRepository
from app.storage.repositories.keys import SqlKeyRepository
from app.storage.repositories.levels import SqlLevelRepository
from app.storage.repositories.maps import SqlMapRepository
from app.storage.repositories.publications import SqlPublicationRepository
from app.storage.repositories.sessions import SqlSessionRepository
from app.storage.repositories.stats import read_stats
from app.storage.repositories.surveys import SqlSurveyRepository
from app.storage.repositories.venues import SqlVenueRepository
from app.storage.repositories.webhooks import SqlWebhookRepository


class SqlUnitOfWork:
    """Repositories over one connection inside one transaction."""

    def __init__(self, connection: Connection, *, writable: bool) -> None:
        self._connection = connection
        self.venues: VenueRepository = SqlVenueRepository(connection, writable=writable)
        self.levels: LevelRepository = SqlLevelRepository(connection, writable=writable)
        self.devices: DeviceRepository = SqlDeviceRepository(connection, writable=writable)
        self.device_models: DeviceModelRepository = SqlDeviceModelRepository(connection, writable=writable)
        self.surveys: SurveyRepository = SqlSurveyRepository(connection, writable=writable)
        self.maps: MapRepository = SqlMapRepository(connection, writable=writable)
        self.contributions: ContributionRepository = SqlContributionRepository(connection, writable=writable)
        self.publications: PublicationRepository = SqlPublicationRepository(connection, writable=writable)
        self.sessions: SessionRepository = SqlSessionRepository(connection, writable=writable)
        self.geofences: GeofenceRepository = SqlGeofenceRepository(connection, writable=writable)
        self.webhooks: WebhookRepository = SqlWebhookRepository(connection, writable=writable)
        self.jobs: JobRepository = SqlJobRepository(connection, writable=writable)
        self.keys: KeyRepository = SqlKeyRepository(connection, writable=writable)
        self.idempotency: IdempotencyRepository = SqlIdempotencyRepository(connection, writable=writable)
        self.ingest: IngestRepository = SqlIngestRepository(connection, writable=writable)
        self.ground_truth: GroundTruthRepository = SqlGroundTruthRepository(connection, writable=writable)
        self.activity: ActivityRepository = SqlActivityRepository(connection, writable=writable)
        self.inventory: InventoryRepository = SqlInventoryRepository(connection, writable=writable)

    def stats(self) -> Stats:
        """Counts of everything stored."""
        return read_stats(self._connection)
