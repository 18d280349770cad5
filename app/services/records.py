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

from app.engine.geodesy import TangentPlane
from app.engine.types import (
    DeviceCalibration,
    FeatureSet,
    Fix,
    ImuSamples,
    MapBuildSettings,
    Prior,
    RadioScans,
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
    origin: MapOrigin | None = None
    """Where an imported map came from; None for maps built from surveys."""


@dataclass(frozen=True, slots=True)
class LevelMap:
    """The map version that is used on a level."""

    level_id: str
    map_id: str


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
class Trajectory:
    """A session's smoothed trajectory, one fix per step."""

    session_id: str
    level_id: str | None
    maps: tuple[LevelMap, ...]
    method: str
    fixes: tuple[Fix, ...]


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
    """A map as it is stored; ``hash`` covers header, tiles, radio layer and lines."""

    hash: str
    tiles: tuple[PackedTile, ...]
    radio: PackedLayer | None = None
    routes: PackedLayer | None = None


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
