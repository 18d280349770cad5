"""Ingest tokens, recordings of phones, markers."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime
from typing import Annotated, Any, Self

import numpy as np
from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from app.api.schemas.base import IdRef, In, Metres, Name, Number, Out, PageOut, Time, example
from app.api.schemas.devices import DEVICE_ID
from app.api.schemas.levels import LEVEL_ID
from app.api.schemas.sessions import PRIOR_EXAMPLE, SESSION_ID, PriorIn, PriorOut
from app.api.schemas.venues import VENUE_ID
from app.engine.types import Waypoints
from app.exchange.phones.assembly import PhoneFrame
from app.services.ingest import records
from app.services.ingest.records import BuildOnArrival, IngestApp, Purpose, RecordingState

TOKEN_ID = "igt_019ab2c4d1e07f3a9b2c4d5e6f"  # noqa: S105 - an id, not a secret
RECORDING_ID = "rec_019ab2c4d1e07f3a9b2c4d5e6f"
_SECRET = "isi_x9Jm2vQ0c1p8Zt4yB6nKd3hLw7RaEf5u"  # noqa: S105 - an example
_TOKEN: dict[str, Any] = {
    "id": TOKEN_ID,
    "name": "Ada's phone",
    "app": "sensor-logger",
    "purpose": "locate",
    "device_id": DEVICE_ID,
    "venue_id": VENUE_ID,
    "level_id": LEVEL_ID,
    "survey_id": None,
    "frame": "android",
    "prior": {**PRIOR_EXAMPLE, "heading_deg": None, "heading_sd_deg": None},
    "contribute": False,
    "build": "publish",
    "route": [],
    "created_at": "2026-11-22T09:30:00.000Z",
    "last_used_at": None,
    "revoked_at": None,
}
_RECORDING: dict[str, Any] = {
    "id": RECORDING_ID,
    "token_id": TOKEN_ID,
    "device_id": DEVICE_ID,
    "app_session": "5f2c1a",
    "purpose": "locate",
    "venue_id": VENUE_ID,
    "level_id": LEVEL_ID,
    "session_id": SESSION_ID,
    "survey_id": None,
    "walk_ids": [],
    "state": "open",
    "problem": "",
    "n_messages": 42,
    "n_late": 0,
    "n_samples": 2050,
    "annotations": [{"t_ms": 1764000012300.0, "text": "A3"}],
    "opened_at": "2026-11-22T09:30:00.000Z",
    "last_at": "2026-11-22T09:30:42.000Z",
    "closed_at": None,
}
MARKERS_EXAMPLE: dict[str, Any] = {"markers": [{"name": "A3", "x": 12.5, "y": 4.0}]}
MarkerName = Annotated[Name, Field(max_length=100)]


class IngestTokenIn(In):
    """A token to make: which device may send what to where."""

    model_config = example(
        {"name": "Ada's phone", "app": "sensor-logger", "device_id": DEVICE_ID, "level_id": LEVEL_ID}
    )

    name: Name
    app: IngestApp
    purpose: Purpose = Purpose.LOCATE
    device_id: IdRef
    venue_id: Annotated[IdRef | None, Field(description="To be located on any level of it.")] = None
    level_id: Annotated[IdRef | None, Field(description="Instead of a venue; a survey needs it.")] = None
    survey_id: Annotated[IdRef | None, Field(description="Where walks go; without it a survey is made.")] = None
    frame: Annotated[
        PhoneFrame,
        Field(description="Signs of the accelerometer: `ios` is turned, unless the app standardises it."),
    ] = PhoneFrame.ANDROID
    prior: Annotated[PriorIn | None, Field(description="Of each session that a recording opens.")] = None
    contribute: Annotated[bool, Field(description="Offer what its sessions saw to the maps.")] = False
    build: Annotated[
        BuildOnArrival,
        Field(description="When a survey walk has come in: update the map (`publish`), build a draft, or do nothing."),
    ] = BuildOnArrival.PUBLISH
    route: Annotated[
        tuple[MarkerName, ...],
        Field(max_length=2000, description="Markers in the order they are walked, for annotations without a text."),
    ] = ()

    def new(self) -> records.NewToken:
        """As the service takes it."""
        return records.NewToken(
            name=self.name,
            app=self.app,
            purpose=self.purpose,
            device_id=self.device_id,
            venue_id=self.venue_id,
            level_id=self.level_id,
            frame=self.frame,
            prior=self.prior.prior() if self.prior else None,
            contribute=self.contribute,
            survey_id=self.survey_id,
            build=self.build,
            route=self.route,
        )


class IngestTokenOut(Out):
    """A token without its secret."""

    model_config = example(_TOKEN)

    id: str
    name: str
    app: IngestApp
    purpose: Purpose
    device_id: str
    venue_id: str
    level_id: str | None
    survey_id: str | None
    frame: PhoneFrame
    prior: PriorOut | None
    contribute: bool
    build: BuildOnArrival
    route: list[str]
    created_at: Time
    last_used_at: Annotated[Time | None, Field(description="To the minute.")]
    revoked_at: Time | None

    @classmethod
    def of(cls, token: records.IngestToken) -> Self:
        """Show a token."""
        names = ("id", "name", "app", "purpose", "device_id", "venue_id", "level_id", "survey_id", "frame")
        flags = ("contribute", "build", "created_at", "last_used_at", "revoked_at")
        return cls(
            **{name: getattr(token, name) for name in (*names, *flags)},
            prior=None if token.prior is None else PriorOut.of(token.prior),
            route=list(token.route),
        )


class NewIngestTokenOut(IngestTokenOut):
    """A token just made: the only time its secret is told."""

    model_config = example(
        {
            **_TOKEN,
            "token": _SECRET,
            "url": f"https://isodyn.example.org/v1/ingest/sensor-logger/{_SECRET}",
            "qr_svg": '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 53 53"></svg>',
            "settings": ["Data Streaming: Enable HTTP Push"],
        }
    )

    token: str
    url: Annotated[str, Field(description="What the app is to be given.")]
    qr_svg: Annotated[str, Field(description="The address as a QR code, an SVG picture, black on white.")]
    settings: Annotated[list[str], Field(description="What to choose in the app.")]


class IngestTokenPage(PageOut):
    """Tokens, newest first, revoked ones too."""

    model_config = example({"items": [_TOKEN], "next_cursor": None})

    items: list[IngestTokenOut]


class AnnotationOut(Out):
    """What the user noted at a moment."""

    t_ms: float
    text: str


class RecordingOut(Out):
    """One recording of a phone."""

    model_config = example(_RECORDING)

    id: str
    token_id: str
    device_id: str
    app_session: Annotated[str, Field(description="The app's own name of it.")]
    purpose: Purpose
    venue_id: str
    level_id: str | None
    session_id: Annotated[str | None, Field(description="The session it feeds (`locate`).")]
    survey_id: str | None
    walk_ids: Annotated[list[str], Field(description="What was made of it (`survey`).")]
    state: Annotated[RecordingState, Field(description="`waiting`: a survey recording that lacks waypoints.")]
    problem: Annotated[str, Field(description="What is wrong; empty: nothing.")]
    n_messages: int
    n_late: Annotated[int, Field(description="Messages that came after their turn was given up.")]
    n_samples: int
    annotations: list[AnnotationOut]
    opened_at: Time
    last_at: Time
    closed_at: Time | None

    @classmethod
    def of(cls, recording: records.RecordingInfo) -> Self:
        """Show a recording."""
        plain = {name: getattr(recording, name) for name in cls.model_fields if name not in ("annotations", "walk_ids")}
        notes = [AnnotationOut(t_ms=note.t_ns / 1e6, text=note.text) for note in recording.annotations]
        return cls(**plain, annotations=notes, walk_ids=list(recording.walk_ids))


class RecordingPage(PageOut):
    """Recordings, newest first."""

    model_config = example({"items": [_RECORDING], "next_cursor": None})

    items: list[RecordingOut]


class RecordingWaypointsIn(In):
    """Where the phone was, in columns: instead of annotations."""

    model_config = example({"t_ms": [1764000012300.0, 1764000040100.0], "x": [12.5, 30.0], "y": [4.0, 4.0]})

    t_ms: Annotated[list[Number], Field(min_length=2, max_length=2000)]
    x: list[Metres]
    y: list[Metres]

    @model_validator(mode="after")
    def _of_one_length(self) -> Self:
        if not len(self.t_ms) == len(self.x) == len(self.y):
            raise PydanticCustomError(
                "waypoints", "has columns of different lengths", {"remedy": "send one value a waypoint in every column"}
            )
        return self

    def waypoints(self) -> Waypoints:
        """As the engine takes them, in time order."""
        order = np.argsort(np.array(self.t_ms), kind="stable")
        columns = (np.array(column, dtype=np.float64)[order] for column in (self.t_ms, self.x, self.y))
        t_ms, x, y = columns
        return Waypoints(t_ms / 1000.0, x, y)


class MarkerIn(In):
    """A marked point."""

    name: MarkerName
    x: Metres
    y: Metres


class MarkersIn(In):
    """Marked points of a level, in place of what there was."""

    model_config = example(MARKERS_EXAMPLE)

    markers: Annotated[list[MarkerIn], Field(max_length=5000)]

    def records(self) -> list[records.Marker]:
        """As the service takes them."""
        return [records.Marker(one.name.strip(), one.x, one.y) for one in self.markers]


class MarkerOut(Out):
    """A marked point; metres, level frame."""

    name: str
    x: float
    y: float


class MarkersOut(Out):
    """Marked points of a level, by name: an annotation with a marker's name is a waypoint there."""

    model_config = example(MARKERS_EXAMPLE)

    markers: list[MarkerOut]

    @classmethod
    def of(cls, markers: Sequence[records.Marker]) -> Self:
        """Show markers."""
        return cls(markers=[MarkerOut(name=one.name, x=one.x, y=one.y) for one in markers])


def now_ns(now: datetime) -> int:
    """UTC nanoseconds, exact to the microsecond."""
    past = now - datetime(1970, 1, 1, tzinfo=UTC)
    return ((past.days * 86_400 + past.seconds) * 10**6 + past.microseconds) * 1000
