"""Plain records of ingest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from enum import StrEnum

from app.engine.types import Prior
from app.exchange.phones.assembly import PhoneFrame
from app.exchange.phones.readings import Annotation, Readings


class IngestApp(StrEnum):
    """What sends."""

    SENSOR_LOGGER = "sensor-logger"
    PHYPHOX = "phyphox"


class Purpose(StrEnum):
    """What recordings are for."""

    LOCATE = "locate"
    SURVEY = "survey"


class BuildOnArrival(StrEnum):
    """What is done when a survey walk has come in."""

    NONE = "none"
    DRAFT = "draft"
    PUBLISH = "publish"


@dataclass(frozen=True, slots=True)
class Marker:
    """A marked point of a level: a sticker on the floor, a door; ``x`` and ``y`` in level metres."""

    name: str
    x: float
    y: float


@dataclass(frozen=True, slots=True)
class NewToken:
    """What is said of a token to make."""

    name: str
    app: IngestApp
    purpose: Purpose
    device_id: str
    venue_id: str | None
    level_id: str | None
    frame: PhoneFrame = PhoneFrame.ANDROID
    prior: Prior | None = None
    """Of each session that its recordings open."""
    contribute: bool = False
    survey_id: str | None = None
    build: BuildOnArrival = BuildOnArrival.PUBLISH
    route: tuple[str, ...] = ()
    """Names of the markers in the order in which they are walked, for annotations that name none."""


@dataclass(frozen=True, slots=True)
class IngestToken:
    """A secret in a push URL: it lets one device send recordings for one purpose to one place, and nothing else."""

    id: str
    name: str
    app: IngestApp
    purpose: Purpose
    device_id: str
    venue_id: str
    level_id: str | None
    survey_id: str | None
    frame: PhoneFrame
    prior: Prior | None
    contribute: bool
    build: BuildOnArrival
    route: tuple[str, ...]
    key_id: str
    """The key that made it: it answers for what the token contributes."""
    created_at: datetime
    last_used_at: datetime | None
    revoked_at: datetime | None


class RecordingState(StrEnum):
    """Where a recording stands."""

    OPEN = "open"
    CLOSED = "closed"
    WAITING = "waiting"
    """A survey recording that has ended and lacks waypoints."""


@dataclass(frozen=True, slots=True)
class RecordingInfo:
    """One recording of a phone, from its first message to its end."""

    id: str
    token_id: str
    device_id: str
    app_session: str
    """The application's own name of it."""
    part: int
    """Counts up when a recording goes on that was closed."""
    purpose: Purpose
    venue_id: str
    level_id: str | None
    session_id: str | None
    survey_id: str | None
    walk_ids: tuple[str, ...]
    state: RecordingState
    next_number: int
    """Message that is expected next."""
    until_ns: int | None
    """Up to where samples were taken."""
    started_ns: int | None
    """When the application's clock began, where it has one of its own."""
    annotations: tuple[Annotation, ...]
    n_messages: int
    n_samples: int
    n_late: int
    """Messages that came after their turn was given up."""
    problem: str
    """What is wrong, in words for the person with the phone; empty: nothing."""
    opened_at: datetime
    last_at: datetime
    closed_at: datetime | None


@dataclass(frozen=True, slots=True)
class Incoming:
    """One message, of whichever application."""

    app_session: str
    number: int | None
    """Its place in the recording; None: messages come in order."""
    readings: Readings
    frame: PhoneFrame | None = None
    """As the message tells it; None: as the token says."""
    started_ns: int | None = None


@dataclass(frozen=True, slots=True)
class Stored:
    """A message that waits for its turn."""

    number: int
    readings: bytes
    received_at: datetime


@dataclass(frozen=True, slots=True)
class Received:
    """What came of a message: it is stored."""

    recording: RecordingInfo | None
    """None: there was nothing to store (a test push)."""
    repeated: bool = False
    job_ids: Sequence[str] = ()
    """Jobs that its segments are waiting for."""
