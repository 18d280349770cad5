"""Geofences and their events."""

from __future__ import annotations

from typing import Annotated, Any, Self

from pydantic import Field

from app.api.schemas.base import IdRef, In, Metres, Name, Number, Out, PageOut, Time, example
from app.api.schemas.levels import LEVEL_ID
from app.api.schemas.venues import VENUE_ID
from app.engine.geofencing import MAX_VERTICES
from app.services.geofence_records import Geofence, GeofenceEvent, GeofenceEventKind
from app.services.geofences import (
    DEFAULT_CONFIDENCE,
    DEFAULT_EVENTS,
    MAX_CONFIDENCE,
    MAX_DWELL_S,
    MIN_CONFIDENCE,
    GeofenceSpec,
)
from app.services.geofencing import event_data

GEOFENCE_ID = "gfc_019ab2c4d1e07f3a9b2c4d5e6f"
_POLYGON = [[10.0, 4.0], [16.0, 4.0], [16.0, 9.0], [10.0, 9.0]]
_NEW: dict[str, Any] = {
    "name": "Gate 4",
    "level_id": LEVEL_ID,
    "polygon": _POLYGON,
    "events": ["enter", "leave", "dwell"],
    "dwell_s": 120.0,
    "confidence": 0.9,
}
_TIMES = {"created_at": "2026-11-22T09:30:00.000Z", "updated_at": "2026-11-22T09:30:00.000Z"}
_GEOFENCE = {"id": GEOFENCE_ID, **_NEW, **_TIMES}
EVENT_EXAMPLE: dict[str, Any] = {
    "id": "gev_019ab2c4d1e07f3a9b2c4d5e6f",
    "kind": "enter",
    "geofence_id": GEOFENCE_ID,
    "geofence_name": "Gate 4",
    "session_id": "ses_019ab2c4d1e07f3a9b2c4d5e6f",
    "device_id": None,
    "venue_id": VENUE_ID,
    "level_id": LEVEL_ID,
    "seq": 3,
    "t_ms": 1764000004980.0,
    "x": 12.31,
    "y": 4.97,
    "probability": 0.931,
    "dwell_s": None,
    "reason": None,
    "created_at": "2026-11-22T09:30:05.000Z",
}

Point = Annotated[list[Metres], Field(min_length=2, max_length=2)]
Ring = Annotated[
    list[Point],
    Field(
        max_length=MAX_VERTICES + 1,
        description="Corners `[x, y]` of a simple polygon in level metres, 3 to 200, either way round; the first may "
        "be repeated at the end. At most 50 m outside the level's extent.",
    ),
]
Kinds = Annotated[
    list[GeofenceEventKind],
    Field(min_length=1, max_length=3, description="What is told; `dwell` needs `dwell_s`."),
]
Dwell = Annotated[
    Number,
    Field(gt=0, le=MAX_DWELL_S, description="How long a stay must last to be told as `dwell`, s."),
]
Confidence = Annotated[
    Number,
    Field(
        ge=MIN_CONFIDENCE,
        le=MAX_CONFIDENCE,
        description="Entered when a fix is inside with this probability or more, left at one minus it or less.",
    ),
]


class GeofenceIn(In):
    """A geofence to create."""

    model_config = example(_NEW)

    name: Name
    level_id: IdRef
    polygon: Ring
    events: Kinds = sorted(DEFAULT_EVENTS)
    dwell_s: Dwell | None = None
    confidence: Confidence = DEFAULT_CONFIDENCE

    def spec(self) -> GeofenceSpec:
        """What the geofence is to be."""
        return GeofenceSpec(self.name, self.polygon, frozenset(self.events), self.dwell_s, self.confidence)


class GeofencePatch(In):
    """What to change; what is not sent stays as it is."""

    model_config = example({"name": "Gate 4a", "confidence": 0.95})

    name: Name | None = None
    polygon: Ring | None = None
    events: Kinds | None = None
    dwell_s: Dwell | None = None
    confidence: Confidence | None = None

    def spec(self, known: Geofence) -> GeofenceSpec:
        """What the geofence is to be. Without the event ``dwell`` it has no ``dwell_s``, unless one is sent."""
        events = known.events if self.events is None else frozenset(self.events)
        kept = known.dwell_s if GeofenceEventKind.DWELL in events else None
        return GeofenceSpec(
            name=known.name if self.name is None else self.name,
            polygon=known.polygon if self.polygon is None else self.polygon,
            events=events,
            dwell_s=self.dwell_s if "dwell_s" in self.model_fields_set else kept,
            confidence=known.confidence if self.confidence is None else self.confidence,
        )


class GeofenceOut(Out):
    """An area of a level whose crossings are told."""

    model_config = example(_GEOFENCE)

    id: str
    name: str
    level_id: str
    polygon: Annotated[list[list[float]], Field(description="Corners in level metres, counter-clockwise, not closed.")]
    events: list[GeofenceEventKind]
    dwell_s: float | None
    confidence: float
    created_at: Time
    updated_at: Time

    @classmethod
    def of(cls, geofence: Geofence) -> Self:
        """Show a geofence."""
        return cls(
            id=geofence.id,
            name=geofence.name,
            level_id=geofence.level_id,
            polygon=[list(point) for point in geofence.polygon],
            events=[kind for kind in GeofenceEventKind if kind in geofence.events],
            dwell_s=geofence.dwell_s,
            confidence=geofence.confidence,
            created_at=geofence.created_at,
            updated_at=geofence.updated_at,
        )


class GeofencePage(PageOut):
    """Geofences, newest first."""

    model_config = example({"items": [_GEOFENCE], "next_cursor": None})

    items: list[GeofenceOut]


class GeofenceEventOut(Out):
    """A session entered, left or dwelt in a geofence. Webhooks send the same object."""

    model_config = example(EVENT_EXAMPLE)

    id: str
    kind: GeofenceEventKind
    geofence_id: str
    geofence_name: str
    session_id: str
    device_id: str | None
    venue_id: str
    level_id: Annotated[str, Field(description="The geofence's.")]
    seq: Annotated[int | None, Field(description="Segment of the fix that showed it.")]
    t_ms: Annotated[float, Field(description="Time of that fix, Unix milliseconds.")]
    x: Annotated[float | None, Field(description="Where it was, m; null on another level.")]
    y: float | None
    probability: Annotated[float | None, Field(description="That the fix was inside; null where no fix showed it.")]
    dwell_s: Annotated[float | None, Field(description="How long the stay had lasted, s.")]
    reason: Annotated[
        str | None,
        Field(
            description="Why a stay ended without a fix outside: `another level`, `session closed`, `geofence deleted`."
        ),
    ]
    created_at: Time

    @classmethod
    def of(cls, event: GeofenceEvent) -> Self:
        """Show an event."""
        return cls.model_validate(event_data(event))


class GeofenceEventPage(PageOut):
    """Events, newest first."""

    model_config = example({"items": [EVENT_EXAMPLE], "next_cursor": None})

    items: list[GeofenceEventOut]
