"""What the service answers: frozen models. Fields the service adds later are ignored, not refused."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime
from enum import StrEnum
from typing import Any, Generic, TypeVar

from pydantic import BaseModel, ConfigDict

T = TypeVar("T")


class Model(BaseModel):
    """Base of all answers."""

    model_config = ConfigDict(frozen=True, extra="ignore")


class VenueKind(StrEnum):
    """What sort of place a venue is."""

    INDOOR = "indoor"
    ROUTE = "route"
    AREA = "area"


class FeatureSet(StrEnum):
    """What of the field a map holds."""

    VECTOR = "vector"
    HV = "hv"
    TOTAL = "total"


class Status(StrEnum):
    """What a fix claims; only ``ok`` claims a position."""

    OK = "ok"
    AMBIGUOUS = "ambiguous"
    INSUFFICIENT = "insufficient"
    OFF_MAP = "off_map"
    DISTURBED = "disturbed"


class FixKind(StrEnum):
    """Which samples a fix rests on, seen from its time: those up to it, also those of about 5 s after it, or all."""

    FILTERED = "filtered"
    FIXED_LAG = "fixed_lag"
    SMOOTHED = "smoothed"


class JobState(StrEnum):
    """Where a job stands; ``done``, ``failed`` and ``cancelled`` are final."""

    QUEUED = "queued"
    RUNNING = "running"
    DONE = "done"
    FAILED = "failed"
    CANCELLED = "cancelled"

    @property
    def final(self) -> bool:
        """Whether nothing more will happen."""
        return self in {JobState.DONE, JobState.FAILED, JobState.CANCELLED}


class SessionStatus(StrEnum):
    """Whether a session takes segments."""

    OPEN = "open"
    CLOSED = "closed"


class Scope(StrEnum):
    """What a key may do; ``admin`` includes the others."""

    LOCATE = "locate"
    SURVEY = "survey"
    ADMIN = "admin"


class Page(Model, Generic[T]):
    """One page of a list; ``next_cursor`` is None on the last."""

    items: tuple[T, ...]
    next_cursor: str | None = None


class Anchor(Model):
    """Takes the level frame to WGS 84: its origin, and the bearing of +y clockwise from north."""

    latitude_deg: float
    longitude_deg: float
    bearing_deg: float = 0.0
    height_m: float = 0.0


class Extent(Model):
    """A rectangle in the level frame, metres."""

    x_min: float
    y_min: float
    x_max: float
    y_max: float


class Venue(Model):
    """A place with one local frame; ``distance_m`` to its bounding box if it was looked for near a place."""

    id: str
    name: str
    kind: VenueKind
    anchor: Anchor | None = None
    created_at: datetime
    updated_at: datetime
    distance_m: float | None = None


class Level(Model):
    """One storey of a venue; ``distance_m`` to its bounding box if it was looked for near a place."""

    id: str
    venue_id: str
    name: str
    ordinal: int
    extent: Extent
    has_plan_image: bool = False
    has_vector_plan: bool = False
    current_map_id: str | None = None
    created_at: datetime
    updated_at: datetime
    distance_m: float | None = None


class Calibration(Model):
    """What is known about a device: ``offset`` (forward, left, up; uT), its carrier's stride over the model's, and the
    elements of ``soft_iron`` (forward-forward, left-left, up-up, forward-left, forward-up, left-up)."""

    offset: tuple[float, float, float]
    offset_sd: tuple[float, float, float]
    stride_scale: float
    stride_scale_sd: float
    soft_iron: tuple[float, float, float, float, float, float]
    soft_iron_sd: tuple[float, float, float, float, float, float]


class DeviceCalibration(Calibration):
    """What ``n_sessions`` sessions taught about a device, in one epoch of its magnetometer."""

    epoch: str
    n_sessions: int
    updated_at: datetime


class CalibrationSource(StrEnum):
    """Where a session's start comes from."""

    DEVICE = "device"
    MODEL = "model"
    NONE = "none"


class SessionStart(Model):
    """What the next session of a device starts with, if it is of this epoch of its magnetometer; and from where."""

    epoch: str
    source: CalibrationSource
    calibration: Calibration | None = None


class Device(Model):
    """One physical sensor carrier; ``calibrations`` and ``next_session`` are there when it is asked for alone."""

    id: str
    name: str
    model: str | None = None
    created_at: datetime
    calibrations: tuple[DeviceCalibration, ...] = ()
    next_session: SessionStart | None = None


class ModelEstimate(Model):
    """What ``n_taught`` devices of a model have in common: the same values with the deviations of the mean
    (``typical``), of devices among one another (``spread``), and of a new device (``start``)."""

    n_taught: int
    typical: Calibration
    spread: Calibration
    start: Calibration


class DeviceModel(Model):
    """A model that devices name; ``estimate`` is there when it is asked for alone and enough devices taught."""

    name: str
    n_devices: int
    estimate: ModelEstimate | None = None


class Survey(Model):
    """Walks with known positions on one level."""

    id: str
    level_id: str
    name: str
    n_walks: int
    created_at: datetime


class Walk(Model):
    """A stored survey walk, without its samples."""

    id: str
    survey_id: str
    name: str
    device_id: str | None = None
    calibration_epoch: str = ""
    n_samples: int
    n_waypoints: int
    duration_s: float
    length_m: float
    content_hash: str
    created_at: datetime


class WalkTrack(Model):
    """The waypoints of a survey walk, as columns of one length; ``x`` and ``y`` in level metres."""

    walk_id: str
    survey_id: str
    name: str
    t_ms: tuple[int, ...]
    x: tuple[float, ...]
    y: tuple[float, ...]


class WalkReport(Model):
    """What map building found out about one survey walk."""

    walk_id: str
    n_steps: int
    length_m: float
    offset: tuple[float, ...]
    residual_rms: float
    rejected: str | None = None
    stride_scale: float | None = None


class MapOrigin(Model):
    """Where an imported map came from; ``assumed`` says what its file did not tell."""

    source: str
    format: str
    file_hash: str
    title: str = ""
    licence: str = ""
    attribution: str = ""
    assumed: tuple[str, ...] = ()


class MapInfo(Model):
    """A finished map version, without its cells; without a radio layer ``n_transmitters`` is None.

    ``kind`` is "build" (from all walks at once) or "update": then ``added`` and ``removed`` are what its parent lacked
    and had too much, and ``walks`` reports on those added.
    ``origin`` is None for maps that were built from surveys.
    """

    id: str
    level_id: str
    version: int
    parent_id: str | None = None
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
    walks: tuple[WalkReport, ...] = ()
    build_s: float
    n_transmitters: int | None = None
    radio_cell_m: float | None = None
    n_routes: int | None = None
    kind: str = "build"
    added: tuple[str, ...] = ()
    removed: tuple[str, ...] = ()
    origin: MapOrigin | None = None
    created_at: datetime


class Publication(Model):
    """A map version became the one that new sessions on its level use; ``from_map_id`` is the one before."""

    id: str
    level_id: str
    map_id: str
    from_map_id: str | None = None
    key_id: str | None = None
    note: str = ""
    created_at: datetime


class MapSource(Model):
    """Who contributed to a map version: a survey walk, or a session; ``rejected`` says why a walk was left out."""

    id: str
    kind: str
    survey_id: str | None = None
    device_id: str | None = None
    contributor: str | None = None
    n_samples: int | None = None
    n_used: int | None = None
    rejected: str | None = None


class Area(Model):
    """So many nodes of a map, and the area they stand for."""

    nodes: int
    area_m2: float


class FieldChange(Model):
    """Change of one component of the field where both versions are mapped, uT (new minus old)."""

    component: str
    mean: float
    rms: float
    p95: float
    largest: float


class TileCounts(Model):
    """Stored tiles: shared by both versions, of the new one only, of the old one only."""

    shared: int
    new: int
    gone: int


class SourceChange(Model):
    """Sources that came and went: how many, and the ids of the first of them."""

    n_added: int
    n_removed: int
    added: tuple[str, ...] = ()
    removed: tuple[str, ...] = ()


class SettingChange(Model):
    """A setting in which two builds differ."""

    name: str
    now: Any = None
    then: Any = None


class MapDiff(Model):
    """What differs between a map version and another one of its level, in the features that both tell."""

    map_id: str
    against: str
    identical: bool
    features: FeatureSet
    cell_m: float
    least_ut: float
    compared: Area
    changed: Area
    significant: Area
    newly_mapped: Area
    no_longer_mapped: Area
    box: Extent | None = None
    change: tuple[FieldChange, ...] = ()
    tiles: TileCounts
    sources: SourceChange
    settings: tuple[SettingChange, ...] = ()


class Prior(Model):
    """What is known before the first segment.

    ``x`` and ``y`` together give a disc of ``radius_m`` and need a level; without them the device may be anywhere.
    ``heading_deg`` is the direction of the device's y axis in the level frame, counter-clockwise from +x.
    """

    x: float | None = None
    y: float | None = None
    radius_m: float = 3.0
    heading_deg: float | None = None
    heading_sd_deg: float | None = None


class LevelMap(Model):
    """The map version that is used on a level."""

    level_id: str
    map_id: str


class SessionInfo(Model):
    """A session as the service keeps it; ``calibration`` is what it knew of its device as it began.

    ``level_id`` and ``map_id`` are None if it was opened on a whole venue.
    """

    id: str
    venue_id: str
    level_id: str | None = None
    map_id: str | None = None
    maps: tuple[LevelMap, ...] = ()
    device_id: str | None = None
    method: str
    method_reason: str | None = None
    parameters: Mapping[str, Any] = {}
    prior: Prior
    status: SessionStatus
    next_seq: int
    created_at: datetime
    closed_at: datetime | None = None
    calibration_epoch: str = ""
    contributes: bool = False
    calibration: Calibration | None = None


class Contribution(Model):
    """What a session offered to the map of a level, and what became of it.

    ``state`` is offered, used, waiting, quarantined, rejected or empty; ``reasons`` say why in words.
    """

    id: str
    session_id: str
    level_id: str
    device_id: str | None = None
    contributor: str
    map_id: str
    state: str
    n_steps: int
    n_kept: int
    n_rows: int
    reasons: tuple[str, ...] = ()
    box: tuple[float, float, float, float] | None = None
    n_agreed: int
    n_disagreed: int
    verdict: str = ""
    created_at: datetime
    decided_at: datetime | None = None


class LastingChange(Model):
    """A lasting change of the field: where (``box``, m), by how much per channel (``delta``, uT), between when."""

    id: str
    level_id: str
    map_id: str
    box: tuple[float, float, float, float]
    area_m2: float
    delta: tuple[float, ...]
    after: datetime | None = None
    before: datetime | None = None
    created_at: datetime


class Ellipse(Model):
    """Half axes and the direction of the major one, counter-clockwise from +x."""

    semi_major_m: float
    semi_minor_m: float
    angle_deg: float


class Hypothesis(Model):
    """One of several places that fit: level, position (m, level frame), covariance (m^2), how likely it is right."""

    level_id: str
    x: float
    y: float
    cov_xx: float
    cov_xy: float
    cov_yy: float
    weight: float


class Position(Model):
    """One fix as an object, with its 95 % ellipse."""

    t_ms: float
    kind: FixKind
    level_id: str
    x: float
    y: float
    cov_xx: float
    cov_xy: float
    cov_yy: float
    heading_deg: float
    status: Status
    quality: float
    sure: bool
    walk_on_m: float | None = None
    hypotheses: tuple[Hypothesis, ...] = ()
    ellipse95: Ellipse


class Job(Model):
    """A durable unit of work. ``result`` names what came of it (``map_id`` of a build)."""

    id: str
    kind: str
    state: JobState
    subject: Mapping[str, str | int] = {}
    attempts: int = 0
    progress: float = 0.0
    progress_text: str = ""
    result: Mapping[str, str | int | float] = {}
    error: str | None = None
    created_at: datetime
    started_at: datetime | None = None
    finished_at: datetime | None = None


class MethodParameter(Model):
    """One parameter of a method; numbers have bounds, words have choices."""

    name: str
    type: str
    default: Any = None
    minimum: float | None = None
    maximum: float | None = None
    choices: tuple[str, ...] | None = None
    description: str = ""


class Method(Model):
    """A positioning method of the service; ``default`` marks the one that is used when none is named."""

    name: str
    summary: str
    reference: str = ""
    kind: str
    default: bool = False
    features: tuple[FeatureSet, ...] = ()
    needs_heading: bool = False
    needs_odometry: bool = False
    dimensions: int = 2
    needs_prior: bool = False
    needs_routes: bool = False
    scales: tuple[str, ...] = ()
    parameters: tuple[MethodParameter, ...] = ()


class ApiKey(Model):
    """A key without its secret."""

    id: str
    name: str
    scopes: frozenset[Scope]
    created_at: datetime
    last_used_at: datetime | None = None
    revoked_at: datetime | None = None


class NewApiKey(ApiKey):
    """A key just created: the only time its secret is told."""

    secret: str


class Stats(Model):
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
    jobs_by_state: Mapping[JobState, int] = {}
