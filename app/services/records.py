"""Records: what services take and return. Frozen, free of SQL and HTTP.

Ids are ``<prefix>_<26 lower-case hex>``: 12 hex digits of Unix milliseconds, then 14 random ones, so they sort
by age and serve as page cursors. Times are timezone-aware UTC datetimes.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime
from enum import StrEnum
from typing import Generic, TypeVar

from app.engine.calibration import ModelEstimate
from app.engine.geodesy import TangentPlane
from app.engine.localization.comparison import FixComparison
from app.engine.mapping.diff import DiffSummary
from app.engine.types import (
    DeviceCalibration,
    FeatureSet,
    Fix,
    Float32Array,
    ImuSamples,
    MapBuildSettings,
    Prior,
    RadioScans,
    SourceKind,
    WalkReport,
    Waypoints,
)
from app.services.aids import NO_AIDS, Aids

T = TypeVar("T")


class VenueKind(StrEnum):
    """What sort of place a venue is."""

    INDOOR = "indoor"
    ROUTE = "route"
    AREA = "area"


class SessionStatus(StrEnum):
    """Whether a session takes segments."""

    OPEN = "open"
    CLOSED = "closed"


class JobKind(StrEnum):
    """What a job does."""

    LOCATE_SEGMENT = "locate_segment"
    BUILD_MAP = "build_map"
    CONTRIBUTE = "contribute"


class MapKind(StrEnum):
    """How a map version came about: from all its walks at once, from its parent and what was new, or from a file."""

    BUILD = "build"
    UPDATE = "update"
    IMPORT = "import"


class ContributionState(StrEnum):
    """What became of what a session offered to a map.

    * ``offered``: not yet weighed;
    * ``used``: some of its rows count in the map;
    * ``waiting``: for a second, independent contributor;
    * ``quarantined``: it contradicts others, or physics;
    * ``rejected``: taken out by a person;
    * ``empty``: nothing in it was sure enough.
    """

    OFFERED = "offered"
    USED = "used"
    WAITING = "waiting"
    QUARANTINED = "quarantined"
    REJECTED = "rejected"
    EMPTY = "empty"


class JobState(StrEnum):
    """Where a job stands; ``done``, ``failed`` and ``cancelled`` are final."""

    QUEUED = "queued"
    RUNNING = "running"
    DONE = "done"
    FAILED = "failed"
    CANCELLED = "cancelled"


class Scope(StrEnum):
    """What a key may do; ``admin`` includes the others."""

    LOCATE = "locate"
    SURVEY = "survey"
    ADMIN = "admin"


@dataclass(frozen=True, slots=True)
class Page(Generic[T]):
    """One page of a list; ``next_cursor`` is None on the last."""

    items: tuple[T, ...]
    next_cursor: str | None


@dataclass(frozen=True, slots=True)
class Found(Generic[T]):
    """A thing that was looked for; ``distance_m`` to its bounding box, if a place was named (0: the place is in it)."""

    item: T
    distance_m: float | None = None


@dataclass(frozen=True, slots=True)
class Anchor:
    """Takes the level frame to WGS 84: the frame's origin, and the bearing of +y clockwise from north."""

    latitude_deg: float
    longitude_deg: float
    bearing_deg: float = 0.0
    height_m: float = 0.0

    def plane(self) -> TangentPlane:
        """The level frame in WGS 84."""
        return TangentPlane(self.latitude_deg, self.longitude_deg, self.bearing_deg, self.height_m)


@dataclass(frozen=True, slots=True)
class Venue:
    """A place with one local frame."""

    id: str
    name: str
    kind: VenueKind
    anchor: Anchor | None
    created_at: datetime
    updated_at: datetime


@dataclass(frozen=True, slots=True)
class Level:
    """One storey; ``extent`` is ``(x_min, y_min, x_max, y_max)`` in metres."""

    id: str
    venue_id: str
    name: str
    ordinal: int
    extent: tuple[float, float, float, float]
    has_plan_image: bool
    has_vector_plan: bool
    current_map_id: str | None
    created_at: datetime
    updated_at: datetime


@dataclass(frozen=True, slots=True)
class Device:
    """One physical sensor carrier."""

    id: str
    name: str
    model: str | None
    created_at: datetime


@dataclass(frozen=True, slots=True)
class DeviceMemory:
    """What ``n_sessions`` sessions taught about a device, in one epoch of its magnetometer's own calibration."""

    device_id: str
    epoch: str
    calibration: DeviceCalibration
    n_sessions: int
    updated_at: datetime


class CalibrationSource(StrEnum):
    """Where a session's start comes from: its device (and, for the rest, its model), its model, or nowhere."""

    DEVICE = "device"
    MODEL = "model"
    NONE = "none"


@dataclass(frozen=True, slots=True)
class StartingCalibration:
    """What a session of a device starts with in an epoch of its magnetometer; None: nothing is known."""

    epoch: str
    source: CalibrationSource
    calibration: DeviceCalibration | None


@dataclass(frozen=True, slots=True)
class DeviceModel:
    """A model that devices name.

    ``estimate`` is what they have in common: None where it was not asked for, or where so few taught something that it
    would tell of single ones.
    """

    name: str
    n_devices: int
    estimate: ModelEstimate | None = None


@dataclass(frozen=True, slots=True)
class Carrier:
    """The device of a survey walk, in an epoch of its magnetometer; and whether it knows the walk's offset already."""

    device_id: str
    epoch: str
    offset_remembered: bool


@dataclass(frozen=True, slots=True)
class Survey:
    """Walks with known positions on one level."""

    id: str
    level_id: str
    name: str
    n_walks: int
    created_at: datetime


@dataclass(frozen=True, slots=True)
class NewWalk:
    """A survey walk as uploaded; ``content_hash`` (sha256 hex) detects repetition."""

    name: str
    samples: ImuSamples
    waypoints: Waypoints
    content_hash: str
    wifi: RadioScans | None = None
    device_id: str | None = None
    ble: RadioScans | None = None
    calibration_epoch: str = ""


@dataclass(frozen=True, slots=True)
class Walk:
    """A stored survey walk, without its samples."""

    id: str
    survey_id: str
    name: str
    device_id: str | None
    n_samples: int
    n_waypoints: int
    duration_s: float
    length_m: float
    """Sum of the straight legs between waypoints."""
    content_hash: str
    created_at: datetime
    calibration_epoch: str = ""
    """Of the device's magnetometer, as sessions name it."""


@dataclass(frozen=True, slots=True)
class MapOrigin:
    """Where a map came from that was not built here.

    ``source`` is ``import``; ``file_hash`` (sha256 hex) and ``format`` are the file's, the texts its sender's or its
    own; ``assumed`` says in words what the file did not tell.
    """

    source: str
    format: str
    file_hash: str
    title: str = ""
    licence: str = ""
    attribution: str = ""
    assumed: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class MapInfo:
    """A finished map version, without its tiles. ``hash`` is the content hash (strong ETag)."""

    id: str
    level_id: str
    version: int
    parent_id: str | None
    hash: str
    features: FeatureSet
    x0: float
    y0: float
    cell_m: float
    rows: int
    columns: int
    mapped_m: float
    noise_sd: tuple[float, ...]
    mapped_share: float
    mapped_area_m2: float
    n_walks: int
    n_samples: int
    length_scale_m: float
    field_sd: tuple[float, ...]
    walks: tuple[WalkReport, ...]
    build_s: float
    created_at: datetime
    has_obstacle: bool = False
    """Whether the level's vector plan limits where people walk."""
    n_transmitters: int | None = None
    """Access points and beacons of the radio layer; None without one."""
    radio_cell_m: float | None = None
    n_routes: int | None = None
    """Survey lines kept with the map; None for maps built before they were."""
    kind: MapKind = MapKind.BUILD
    added: tuple[str, ...] = ()
    """Sources that an update added to its parent's (walks that could not be placed among them)."""
    removed: tuple[str, ...] = ()
    model: Mapping[str, object] | None = None
    """What was fitted, plain values; None for maps built before it was kept: those cannot be updated."""
    origin: MapOrigin | None = None
    """Where an imported map came from; None for maps built from surveys."""


@dataclass(frozen=True, slots=True)
class LevelMap:
    """The map version that is used on a level."""

    level_id: str
    map_id: str


@dataclass(frozen=True, slots=True)
class Publication:
    """A map version became the one that new sessions on its level use.

    ``from_map_id`` is the one before, None for a level's first; ``key_id`` says who published it, None if the service
    did so without being asked.
    """

    id: str
    level_id: str
    map_id: str
    from_map_id: str | None
    key_id: str | None
    note: str
    created_at: datetime


@dataclass(frozen=True, slots=True)
class MapSource:
    """Who contributed to a map version.

    ``n_samples`` counts the placed field samples it brought, of which ``n_used`` have some weight; None for versions of
    before evidence was kept. ``rejected`` says why a walk was left out, if it was.
    """

    id: str
    kind: SourceKind
    survey_id: str | None
    device_id: str | None
    contributor: str | None
    n_samples: int | None
    n_used: int | None
    rejected: str | None


@dataclass(frozen=True, slots=True)
class TileCounts:
    """Tiles of a version by content: shared with the other one, new in it, and of the other one only."""

    shared: int
    new: int
    gone: int


@dataclass(frozen=True, slots=True)
class Change(Generic[T]):
    """What came and what went."""

    added: tuple[T, ...]
    removed: tuple[T, ...]


@dataclass(frozen=True, slots=True)
class SettingChange:
    """A setting in which two builds differ."""

    name: str
    now: object
    then: object


@dataclass(frozen=True, slots=True)
class VersionDiff:
    """What differs between a version and another one of its level; ``sources`` are ids of those in use."""

    map_id: str
    against: str
    identical: bool
    field: DiffSummary
    tiles: TileCounts
    sources: Change[str]
    settings: tuple[SettingChange, ...]


@dataclass(frozen=True, slots=True, eq=False)
class ChangeRaster:
    """One value a node, shape (rows, columns); node ``[0, 0]`` lies at (x0, y0), nodes are ``cell_m`` apart."""

    values: Float32Array
    x0: float
    y0: float
    cell_m: float


@dataclass(frozen=True, slots=True)
class Session:
    """One trip of one device.

    ``level_id`` is None while the session may be on any level of its venue. Pinned when it opens: ``maps``, that of the
    level, or of every level of the venue that has one, and ``prior.calibration``, what the device's earlier sessions
    taught.
    """

    id: str
    venue_id: str
    level_id: str | None
    maps: tuple[LevelMap, ...]
    device_id: str | None
    method: str
    parameters: Mapping[str, object]
    prior: Prior
    status: SessionStatus
    next_seq: int
    created_at: datetime
    closed_at: datetime | None
    calibration_epoch: str = ""
    """Changes when the device's platform recalibrates its magnetometer; the application's word."""
    method_reason: str | None = None
    """Why this method, if it was chosen by the service."""
    contributor: str | None = None
    """Key that answers for what the session contributes to maps; None: it contributes nothing."""


@dataclass(frozen=True, slots=True)
class Contribution:
    """What a session offers to the map of a level, and what became of it; without its rows.

    Attributes
    ----------
    contributor : str
        Key that opened the session.
    map_id : str
        Version on which the session was located.
    n_steps, n_kept, n_rows : int
        Steps of the session, those of them that were sure enough, and rows of evidence made of these.
    reasons : tuple of str
        Why steps were left out.
    box : tuple of float or None
        ``(x_min, y_min, x_max, y_max)`` of the rows, m.
    n_agreed, n_disagreed : int
        Places where independent evidence agreed, and where it did not.
    verdict : str
        What the weighing did with it, in words; empty before.
    """

    id: str
    session_id: str
    level_id: str
    device_id: str | None
    contributor: str
    map_id: str
    state: ContributionState
    n_steps: int
    n_kept: int
    n_rows: int
    reasons: tuple[str, ...]
    box: tuple[float, float, float, float] | None
    n_agreed: int
    n_disagreed: int
    verdict: str
    created_at: datetime
    decided_at: datetime | None


@dataclass(frozen=True, slots=True)
class ContributionVerdict:
    """What the weighing of a level's evidence says of one contribution."""

    id: str
    state: ContributionState
    verdict: str
    n_agreed: int
    n_disagreed: int


@dataclass(frozen=True, slots=True)
class LastingChange:
    """A lasting change of the field that independent passes agree on.

    Attributes
    ----------
    map_id : str
        Version from which on the map shows it.
    box : tuple of float
        ``(x_min, y_min, x_max, y_max)``, m.
    delta : tuple of float, uT
        Mean change per channel.
    after, before : datetime or None
        It came between the last pass that agreed with the old field and the first that did not.
    """

    id: str
    level_id: str
    map_id: str
    box: tuple[float, float, float, float]
    area_m2: float
    delta: tuple[float, ...]
    after: datetime | None
    before: datetime | None
    created_at: datetime


@dataclass(frozen=True, slots=True)
class NewSegment:
    """A segment as uploaded; ``content_hash`` (sha256 hex of its columns) detects conflicting repetition."""

    seq: int
    samples: ImuSamples
    content_hash: str
    aids: Aids = NO_AIDS


@dataclass(frozen=True, slots=True)
class SegmentInfo:
    """A stored segment without its samples, and what came of it."""

    session_id: str
    seq: int
    content_hash: str
    n_samples: int
    t_start: float
    t_end: float
    job_id: str
    job_state: JobState
    error: str | None
    received_at: datetime
    processed_at: datetime | None


@dataclass(frozen=True, slots=True)
class SegmentResult:
    """A segment and what came of it: its fixes, and fixed-lag fixes of steps that lie some seconds back."""

    segment: SegmentInfo
    fixes: tuple[Fix, ...]
    lagged: tuple[Fix, ...]


@dataclass(frozen=True, slots=True)
class Accepted:
    """Answer to an accepted segment; ``repeated`` if the same ``seq`` and content came before."""

    segment: SegmentInfo
    job: Job
    repeated: bool


@dataclass(frozen=True, slots=True)
class Position:
    """A fix as stored: with the segment whose answer told it and its number among those of its kind in the session."""

    session_id: str
    number: int
    seq: int
    fix: Fix


@dataclass(frozen=True, slots=True)
class LastKnown:
    """A session and the last position that was told of it, if there is one."""

    session: Session
    position: Position | None


@dataclass(frozen=True, slots=True)
class Trajectory:
    """A session's smoothed trajectory, one fix per step."""

    session_id: str
    level_id: str | None
    maps: tuple[LevelMap, ...]
    method: str
    fixes: tuple[Fix, ...]


@dataclass(frozen=True, slots=True)
class Replay:
    """A session's fixes on other maps, and how they compare with those that were told then."""

    session_id: str
    level_id: str | None
    maps: tuple[LevelMap, ...]
    maps_then: tuple[LevelMap, ...]
    method: str
    fixes: tuple[Fix, ...]
    comparison: FixComparison


@dataclass(frozen=True, slots=True)
class Located:
    """Result of a one-shot location."""

    fixes: tuple[Fix, ...]
    lagged: tuple[Fix, ...]
    level_id: str | None
    maps: tuple[LevelMap, ...]
    method: str
    method_reason: str | None = None


@dataclass(frozen=True, slots=True)
class Job:
    """A durable unit of work. ``subject`` names what it works on, ``result`` what came of it (ids)."""

    id: str
    kind: JobKind
    state: JobState
    order_key: str
    """Jobs of one key run one after the other, oldest first (the session id; the level id for builds)."""
    subject: Mapping[str, str | int]
    attempts: int
    progress: float
    progress_text: str
    result: Mapping[str, str | int | float]
    error: str | None
    created_at: datetime
    started_at: datetime | None
    finished_at: datetime | None


@dataclass(frozen=True, slots=True)
class NewBuild:
    """Request for a map: of a level, from all its surveys or only some."""

    level_id: str
    settings: MapBuildSettings = field(default_factory=MapBuildSettings)
    survey_ids: tuple[str, ...] = ()
    mode: MapKind = MapKind.BUILD
    """An update keeps the settings of the current map."""
    publish: bool = True
    """Whether new sessions use the version as soon as it is built; a draft waits to be published."""
    key_id: str | None = None
    """Who asked for it."""


@dataclass(frozen=True, slots=True)
class PackedTile:
    """One tile of a map, compressed; ``row`` and ``column`` count tiles, ``hash`` is that of the content."""

    hash: str
    row: int
    column: int
    data: bytes


@dataclass(frozen=True, slots=True)
class PackedLayer:
    """What of a map is not in its tiles (radio layer, lines), compressed; ``hash`` is that of the content."""

    hash: str
    data: bytes


@dataclass(frozen=True, slots=True)
class PackedMap:
    """A map as it is stored; ``hash`` covers header, tiles, radio layer and lines, but not what it rests on."""

    hash: str
    tiles: tuple[PackedTile, ...]
    radio: PackedLayer | None = None
    routes: PackedLayer | None = None
    evidence: tuple[PackedTile, ...] = ()


@dataclass(frozen=True, slots=True)
class ApiKey:
    """A key without its secret. The secret is ``isk_<id part>_<random>``, hashed (SHA-256) at rest."""

    id: str
    name: str
    scopes: frozenset[Scope]
    created_at: datetime
    last_used_at: datetime | None
    revoked_at: datetime | None


@dataclass(frozen=True, slots=True)
class Stats:
    """Counts for operators."""

    venues: int
    levels: int
    surveys: int
    walks: int
    maps: int
    sessions_open: int
    sessions: int
    segments: int
    fixes: int
    jobs_by_state: Mapping[JobState, int]
