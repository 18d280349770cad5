"""Ports: what the use cases need from storage and workers. Adapters live in ``app.storage`` and ``app.workers``.

Repositories own all queries; a unit of work is one transaction. Nothing here names a database.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from collections.abc import Set as AbstractSet
from concurrent.futures import Future
from contextlib import AbstractContextManager
from datetime import datetime
from typing import TYPE_CHECKING, Protocol, TypeVar

from app.engine.mapping.placing import PlacedWalks
from app.engine.types import (
    DeviceCalibration,
    Evidence,
    FeatureSet,
    Fix,
    FixKind,
    GridMap,
    Progress,
    SurveyWalk,
    TrackerState,
    WalkReport,
)
from app.services.activity import ActivityRepository, InventoryRepository
from app.services.aids import Recording
from app.services.geofence_ports import GeofenceRepository
from app.services.ground_truth_records import GroundTruthRepository
from app.services.ingest.ports import IngestRepository
from app.services.records import (
    Anchor,
    ApiKey,
    Carrier,
    Contribution,
    ContributionState,
    ContributionVerdict,
    Device,
    DeviceMemory,
    DeviceModel,
    Found,
    Job,
    JobKind,
    JobState,
    LastingChange,
    LastKnown,
    Level,
    LevelMap,
    MapInfo,
    NewBuild,
    NewSegment,
    NewWalk,
    PackedMap,
    Page,
    Position,
    Publication,
    SegmentInfo,
    SegmentResult,
    Session,
    SessionStatus,
    Stats,
    Survey,
    Venue,
    Walk,
)
from app.services.tasks import MapRef
from app.services.walk_tracks import WalkTrack
from app.services.webhook_ports import WebhookRepository

if TYPE_CHECKING:
    from app.services.search import Search

Box = tuple[float, float, float, float]
"""``(x_min, y_min, x_max, y_max)`` in the level frame, m."""
Spec = TypeVar("Spec")
Result = TypeVar("Result")


class Executor(Protocol):
    """Runs tasks somewhere: inline, in threads, in processes, on other machines."""

    def submit(
        self,
        task: Callable[[Spec, Progress], Result],
        spec: Spec,
        *,
        affinity: str = "",
        on_progress: Progress | None = None,
    ) -> Future[Result]:
        """Start a task. Equal ``affinity`` prefers the same worker (it holds the map already).

        A worker that dies fails the future with :class:`WorkerLostError`; the pool mends itself.
        """
        ...

    def close(self) -> None:
        """Stop all workers; running tasks are abandoned (their jobs are still in the database)."""
        ...


class WorkerLostError(Exception):
    """The worker died while it held the task; the task may be submitted again."""


class VenueRepository(Protocol):
    """Venues and levels."""

    def add(self, venue: Venue) -> None: ...
    def get(self, venue_id: str) -> Venue: ...
    def list(self, *, cursor: str | None, limit: int) -> Page[Venue]: ...
    def find(self, search: Search, *, cursor: str | None, limit: int) -> Page[Found[Venue]]:
        """Venues of a search: nearest first where it names a place, else newest first."""
        ...

    def update(self, venue_id: str, *, name: str, anchor: Anchor | None, now: datetime) -> Venue: ...
    def delete(self, venue_id: str) -> None: ...


class LevelRepository(Protocol):
    """Levels with their plans."""

    def add(self, level: Level) -> None: ...
    def get(self, level_id: str) -> Level: ...
    def list(self, *, venue_id: str | None, cursor: str | None, limit: int) -> Page[Level]: ...
    def find(self, search: Search, *, venue_id: str | None, cursor: str | None, limit: int) -> Page[Found[Level]]:
        """Levels of a search: nearest first where it names a place, else newest first."""
        ...

    def update(
        self, level_id: str, *, name: str, ordinal: int, extent: tuple[float, float, float, float], now: datetime
    ) -> Level: ...
    def set_plan_image(self, level_id: str, png: bytes, now: datetime) -> None: ...
    def plan_image(self, level_id: str) -> bytes | None: ...
    def set_vector_plan(self, level_id: str, geojson: bytes, now: datetime) -> None: ...
    def vector_plan(self, level_id: str) -> bytes | None: ...
    def set_current_map(self, level_id: str, map_id: str, now: datetime) -> str | None:
        """Make a map the one that new sessions use, and return the one of before: see ``services.versions.publish``."""
        ...

    def current_maps(self, venue_id: str, *, limit: int) -> Sequence[LevelMap]:
        """Current maps of the venue's levels that have one, lowest level first, at most ``limit``."""
        ...


class DeviceRepository(Protocol):
    """Sensor carriers."""

    def add(self, device: Device) -> None: ...
    def get(self, device_id: str) -> Device: ...
    def list(self, *, cursor: str | None, limit: int) -> Page[Device]: ...
    def memories(self, device_id: str) -> Sequence[DeviceMemory]:
        """What is remembered of the device, the epoch used last first; in a writing transaction nobody else changes it.

        NotFoundError if there is no such device.
        """
        ...

    def set_memory(self, memory: DeviceMemory) -> None:
        """Remember this of the device's epoch, in place of what was."""
        ...

    def forget(self, device_id: str) -> None:
        """Delete all that is remembered of the device."""
        ...


class DeviceModelRepository(Protocol):
    """Models that devices name, and what is remembered of their devices."""

    def list(self, *, cursor: str | None, limit: int) -> Page[DeviceModel]:
        """Models by name, without estimates."""
        ...

    def get(self, name: str) -> DeviceModel: ...
    def memories(self, name: str, *, limit: int, without: str | None = None) -> Sequence[DeviceCalibration]:
        """One memory a device of the model, but of one: those used last, at most ``limit``."""
        ...


class SurveyRepository(Protocol):
    """Surveys and their walks."""

    def add(self, survey: Survey) -> None: ...
    def get(self, survey_id: str) -> Survey: ...
    def list(self, *, level_id: str | None, cursor: str | None, limit: int) -> Page[Survey]: ...
    def add_walk(self, walk: Walk, data: NewWalk) -> None: ...
    def get_walk(self, walk_id: str) -> Walk: ...
    def find_walk(self, survey_id: str, content_hash: str) -> Walk | None: ...
    def list_walks(self, survey_id: str, *, cursor: str | None, limit: int) -> Page[Walk]: ...
    def delete_walk(self, walk_id: str) -> None: ...
    def list_tracks(
        self, level_id: str, survey_ids: Sequence[str], *, cursor: str | None, limit: int
    ) -> Page[WalkTrack]: ...
    def count_walks(self, level_id: str, survey_ids: Sequence[str]) -> int: ...
    def carriers(self, level_id: str) -> Mapping[str, Carrier]:
        """The device of each of the level's walks that name one, by walk id."""
        ...

    def load_walk(self, walk_id: str) -> SurveyWalk:
        """Samples of one walk."""
        ...

    def mark_offsets_remembered(self, walk_ids: Sequence[str], now: datetime) -> None:
        """Note that these walks' offsets are in their devices' memories."""
        ...

    def find_walks(self, walk_ids: Sequence[str]) -> Mapping[str, Walk]:
        """Those of these walks that are stored (still), by id."""
        ...

    def walk_ids(self, level_id: str, survey_ids: Sequence[str]) -> Sequence[str]:
        """Ids of the level's walks (of these surveys only, when any are named), oldest first."""
        ...

    def load_walks(
        self, level_id: str, survey_ids: Sequence[str], *, only: Sequence[str] | None = None
    ) -> Sequence[SurveyWalk]:
        """Samples of the level's walks (of these surveys, or only these walks, when any are named), oldest first."""
        ...


class MapRepository(Protocol):
    """Immutable map versions as content-hashed tiles."""

    def add_build(self, job_id: str, build: NewBuild) -> None: ...
    def get_build(self, job_id: str) -> NewBuild: ...
    def finish_build(self, job_id: str, map_id: str) -> None: ...
    def awaits_build(self, level_id: str) -> bool:
        """Whether a build or update of the level waits that nobody has begun, other than of a draft."""
        ...

    def build_of(self, map_id: str) -> NewBuild | None:
        """The build that a map came of; None for those of before this was noted, and for maps that were not built."""
        ...

    def tile_hashes(self, map_id: str) -> Sequence[str]: ...
    def reports(self, map_id: str) -> Mapping[str, WalkReport]:
        """Reports about the walks of a version by walk id: of its build, and of the updates since."""
        ...

    def pack(self, grid_map: GridMap, evidence: Evidence | None = None) -> PackedMap:
        """Cut into tiles, compress and hash; touches no table, so it may run outside a write transaction."""
        ...

    def add(self, info: MapInfo, packed: PackedMap, *, keep: Box | None = None) -> None:
        """Store a version. ``keep``: an update's evidence is that of this box; outside it stays the parent's."""
        ...

    def evidence(self, map_id: str, box: Box | None = None) -> Evidence | None:
        """What a map rests on, in the tiles that the box touches if one is given; None if it was not kept."""
        ...

    def sources(self, map_id: str) -> AbstractSet[str]:
        """Ids of all walks and contributions that went into a version or were found unfit for it."""
        ...

    def get(self, map_id: str) -> MapInfo: ...
    def list(self, *, level_id: str | None, cursor: str | None, limit: int) -> Page[MapInfo]: ...
    def next_version(self, level_id: str) -> int: ...
    def paced_walks(self, level_id: str) -> AbstractSet[str]:
        """Ids of the walks whose stride the reports of the level's maps tell."""
        ...

    def load(self, map_id: str) -> GridMap: ...


class ContributionRepository(Protocol):
    """What sessions offered to maps, and changes of the field that many of them show."""

    def add(self, contribution: Contribution, rows: Evidence) -> None: ...
    def get(self, contribution_id: str) -> Contribution: ...
    def list(
        self,
        *,
        level_id: str | None,
        session_id: str | None,
        contributor: str | None,
        state: ContributionState | None,
        cursor: str | None,
        limit: int,
    ) -> Page[Contribution]: ...
    def of_session(self, session_id: str) -> Sequence[Contribution]:
        """What a session contributed, one a level."""
        ...

    def live(self, level_id: str) -> Sequence[str]:
        """Ids of those that are to be among the evidence of the level's map, oldest first."""
        ...

    def load(self, features: FeatureSet, ids: Sequence[str]) -> Evidence: ...
    def decide(self, verdicts: Sequence[ContributionVerdict], now: datetime) -> None:
        """Note what the weighing found; what a person rejected stays so."""
        ...

    def set_state(self, contribution_id: str, state: ContributionState, now: datetime) -> Contribution: ...
    def delete(self, contribution_id: str) -> None: ...
    def boxes(self, ids: Sequence[str]) -> Mapping[str, Box]:
        """Where the rows of these contributions lie, of those that have any."""
        ...

    def track_record(self, *, other_than: str) -> Mapping[str, tuple[int, int]]:
        """Places where contributors agreed with independent evidence and where not, on levels but this one."""
        ...

    def add_changes(self, changes: Sequence[LastingChange]) -> None: ...
    def list_changes(self, *, level_id: str | None, cursor: str | None, limit: int) -> Page[LastingChange]: ...


class PublicationRepository(Protocol):
    """Which map version a level used since when."""

    def add(self, publication: Publication) -> None: ...
    def latest(self, level_id: str) -> Publication | None: ...
    def list(self, level_id: str, *, cursor: str | None, limit: int) -> Page[Publication]: ...


class SessionRepository(Protocol):
    """Sessions, their segments, tracker state and fixes."""

    def add(self, session: Session) -> None: ...
    def get(self, session_id: str) -> Session: ...
    def list(
        self,
        *,
        venue_id: str | None,
        level_id: str | None,
        device_id: str | None,
        status: str | None,
        cursor: str | None,
        limit: int,
    ) -> Page[Session]: ...
    def close(self, session_id: str, now: datetime) -> Session: ...
    def add_segment(self, session_id: str, segment: NewSegment, job_id: str, now: datetime) -> None:
        """Store the raw samples as compressed columns and advance ``next_seq``."""
        ...

    def get_segment(self, session_id: str, seq: int) -> SegmentInfo: ...
    def get_result(self, session_id: str, seq: int) -> SegmentResult:
        """A segment with all of its fixes."""
        ...

    def list_segments(self, session_id: str, *, cursor: str | None, limit: int) -> Page[SegmentInfo]: ...
    def last_segment(self, session_id: str) -> SegmentInfo | None: ...
    def load_segment(self, session_id: str, seq: int) -> Recording: ...
    def load_segments(self, session_id: str, limit: int) -> Sequence[Recording]:
        """Samples of the first ``limit`` segments whose job is done, oldest first."""
        ...

    def state(self, session_id: str) -> TrackerState | None: ...
    def learned(self, session_id: str) -> DeviceCalibration | None:
        """What the session learned last about its device."""
        ...

    def mark_remembered(self, session_id: str, now: datetime) -> bool:
        """Note that what the session learned is in its device's memory; False if that was noted before."""
        ...

    def record_result(
        self,
        session_id: str,
        seq: int,
        state: TrackerState,
        fixes: Sequence[Fix],
        now: datetime,
        *,
        lagged: Sequence[Fix] = (),
        calibration: DeviceCalibration | None = None,
    ) -> SessionStatus:
        """Store new state, fixes of both kinds and calibration (None: it stays), and mark the segment processed.

        Returns whether the session is open still; until the transaction ends nobody else changes that.
        """
        ...

    def record_failure(self, session_id: str, seq: int, error: str, now: datetime) -> None: ...
    def list_positions(
        self,
        session_id: str,
        *,
        seq: int | None,
        cursor: str | None,
        limit: int,
        kind: FixKind = FixKind.FILTERED,
    ) -> Page[Position]:
        """Fixes of a kind that is stored, in time order; the cursor is the ``number`` of the last one seen."""
        ...

    def last_known(
        self,
        *,
        venue_id: str | None,
        level_id: str | None,
        limit: int,
        only: Sequence[str] | None = None,
    ) -> Sequence[LastKnown]:
        """Sessions with their last fixes, newest first: the open ones, or ``only`` these whether open or not.

        ``level_id``: where the last fix is, or where the session was opened if it has none.
        """
        ...


class JobRepository(Protocol):
    """The durable queue."""

    def add(self, job: Job) -> None: ...
    def get(self, job_id: str) -> Job: ...
    def list(
        self, *, kinds: Sequence[JobKind], state: JobState | None, cursor: str | None, limit: int
    ) -> Page[Job]: ...
    def claim(self, *, limit: int, now: datetime, kind: JobKind | None = None) -> Sequence[Job]:
        """Mark up to ``limit`` queued jobs (of one kind, if named) as running, oldest first, at most one per
        ``order_key`` and none whose key already has one running; ``attempts`` grows by one."""
        ...

    def requeue_running(self) -> int:
        """At start-up: what was running when the process died is queued again."""
        ...

    def requeue(self, job_id: str, *, attempts: int | None = None) -> bool:
        """Queue a *running* job again (of this attempt only, if given); False if it does not run."""
        ...

    def set_progress(self, job_id: str, fraction: float, text: str) -> None: ...
    def finish(
        self,
        job_id: str,
        state: JobState,
        now: datetime,
        *,
        result: Mapping[str, str | int | float] | None = None,
        error: str | None = None,
        attempts: int | None = None,
    ) -> bool:
        """Move a *running* (or, for cancellation, queued) job to a final state; False if it was final already.

        With ``attempts``, only if the job runs in that very attempt: a late answer of a lost worker is dropped.
        """
        ...

    def count(self, *states: JobState) -> int: ...
    def is_pending(self, order_key: str) -> bool:
        """Whether a job of this key is queued or running."""
        ...


class KeyRepository(Protocol):
    """API keys by the hash of their secret."""

    def add(self, key: ApiKey, secret_hash: str) -> None: ...
    def find(self, secret_hash: str) -> ApiKey | None: ...
    def get(self, key_id: str) -> ApiKey: ...
    def list(self, *, cursor: str | None, limit: int) -> Page[ApiKey]: ...
    def revoke(self, key_id: str, now: datetime) -> ApiKey: ...
    def touch(self, key_id: str, now: datetime) -> None: ...
    def count(self) -> int: ...


class IdempotencyRepository(Protocol):
    """Answers given to creating posts with an ``Idempotency-Key``, kept for a day."""

    def find(self, key_id: str, idempotency_key: str) -> tuple[str, str] | None:
        """``(request hash, created id)``."""
        ...

    def add(self, key_id: str, idempotency_key: str, request_hash: str, created_id: str, now: datetime) -> None: ...


class UnitOfWork(Protocol):
    """One transaction. Leaves by commit (normal exit) or roll-back (exception)."""

    venues: VenueRepository
    levels: LevelRepository
    devices: DeviceRepository
    device_models: DeviceModelRepository
    surveys: SurveyRepository
    maps: MapRepository
    contributions: ContributionRepository
    publications: PublicationRepository
    sessions: SessionRepository
    geofences: GeofenceRepository
    webhooks: WebhookRepository
    jobs: JobRepository
    keys: KeyRepository
    idempotency: IdempotencyRepository
    ingest: IngestRepository
    ground_truth: GroundTruthRepository
    activity: ActivityRepository
    inventory: InventoryRepository

    def stats(self) -> Stats: ...


class UnitOfWorkFactory(Protocol):
    """Opens transactions. ``write=True`` takes the write lock at once (``BEGIN IMMEDIATE`` on SQLite)."""

    def __call__(self, *, write: bool = False) -> AbstractContextManager[UnitOfWork]: ...


class MapCache(Protocol):
    """Local cache of assembled maps, by content hash, as files that workers memory-map."""

    def ref(self, info: MapInfo, load: Callable[[], GridMap]) -> MapRef:
        """File of this map; ``load`` fills it when it is missing."""
        ...

    def open(self, ref: MapRef) -> GridMap:
        """Memory-map a cached map."""
        ...


class Checkpoints(Protocol):
    """Keeps the placed walks of builds that run, so that an interrupted build need not place them again."""

    def load(self, key: str) -> PlacedWalks | None: ...
    def put(self, key: str, placed: PlacedWalks) -> None: ...
    def drop(self, key: str) -> None: ...


class JobListener(Protocol):
    """Told after commit that a job reached a final state (or that there is new work)."""

    def job_queued(self, job: Job) -> None: ...
    def job_finished(self, job: Job) -> None: ...
