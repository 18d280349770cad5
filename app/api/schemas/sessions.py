"""Sessions and priors."""

from __future__ import annotations

import math
from typing import Annotated, Any, Self

from pydantic import Field, PlainValidator, WithJsonSchema, model_validator
from pydantic_core import PydanticCustomError

from app.api.schemas.base import Epoch, IdRef, In, Metres, Number, Out, PageOut, Time, example
from app.api.schemas.devices import CALIBRATION_EXAMPLE, DEVICE_ID, CalibrationOut
from app.api.schemas.levels import LEVEL_ID
from app.api.schemas.maps import MAP_ID
from app.api.schemas.methods import MethodName, MethodReason
from app.api.schemas.places import LevelOfTrip, MapIdOut, MapOfTrip, MapsOfTrip, MapsOut, VenueOfTrip, maps_object
from app.api.schemas.venues import VENUE_ID
from app.engine.localization.registry import DEFAULT_METHOD
from app.engine.types import Prior
from app.services import records
from app.services.records import SessionStatus

SESSION_ID = "ses_019ab2c4d1e07f3a9b2c4d5e6f"
PRIOR_EXAMPLE: dict[str, Any] = {"x": 12.0, "y": 4.0, "radius_m": 3.0}
_SESSION = {
    "id": SESSION_ID,
    "venue_id": VENUE_ID,
    "level_id": LEVEL_ID,
    "map_id": MAP_ID,
    "maps": [{"level_id": LEVEL_ID, "map_id": MAP_ID}],
    "device_id": DEVICE_ID,
    "method": DEFAULT_METHOD,
    "method_reason": None,
    "parameters": {},
    "prior": {"x": 12.0, "y": 4.0, "radius_m": 3.0, "heading_deg": None, "heading_sd_deg": None},
    "status": "open",
    "next_seq": 4,
    "created_at": "2026-11-22T09:30:00.000Z",
    "closed_at": None,
    "calibration_epoch": "bias-5f2c",
    "contributes": False,
    "calibration": CALIBRATION_EXAMPLE,
}
_DEFAULTS = Prior(level_id="")


def _parameter(value: object) -> object:
    if isinstance(value, str | bool | int) or (isinstance(value, float) and math.isfinite(value)):
        return value
    raise PydanticCustomError(
        "parameter", "is not a finite number, a string or a boolean", {"remedy": "see GET /v1/methods for its type"}
    )


# A union would put the name of its branch into the path of every error.
ParameterValue = Annotated[
    object, PlainValidator(_parameter), WithJsonSchema({"type": ["number", "string", "boolean"]})
]
Parameters = Annotated[
    dict[Annotated[str, Field(max_length=64)], ParameterValue],
    Field(max_length=64, description="Parameters of the method; what is not named has its default."),
]


class PriorIn(In):
    """What is known before the first segment. Without `x` and `y`: anywhere on the level; they need a `level_id`."""

    model_config = example(PRIOR_EXAMPLE)

    x: Metres | None = None
    y: Metres | None = None
    radius_m: Annotated[Number, Field(gt=0, le=1e5, description="Of a disc around (x, y), even inside.")] = (
        _DEFAULTS.radius_m
    )
    heading_deg: Annotated[
        Number | None,
        Field(ge=-360, le=360, description="Of the device's y axis, counter-clockwise from +x; null: unknown."),
    ] = None
    heading_sd_deg: Annotated[Number, Field(gt=0, le=360)] = round(math.degrees(_DEFAULTS.heading_sd), 6)

    @model_validator(mode="after")
    def _both_or_none(self) -> Self:
        if (self.x is None) != (self.y is None):
            raise PydanticCustomError(
                "prior", "has only one of x and y", {"remedy": "send both x and y, or neither (anywhere on the level)"}
            )
        return self

    def prior(self) -> Prior:
        """Return the engine's prior; the service puts the level in."""
        return Prior(
            level_id=_DEFAULTS.level_id,
            x=self.x,
            y=self.y,
            radius_m=self.radius_m,
            heading=None if self.heading_deg is None else math.radians(self.heading_deg),
            heading_sd=math.radians(self.heading_sd_deg),
        )


class PriorOut(Out):
    """What was known before the first segment."""

    x: float | None
    y: float | None
    radius_m: float
    heading_deg: float | None
    heading_sd_deg: Annotated[float | None, Field(description="Null while the heading is.")]

    @classmethod
    def of(cls, prior: Prior) -> Self:
        """Show a prior."""
        return cls(
            x=prior.x,
            y=prior.y,
            radius_m=prior.radius_m,
            heading_deg=None if prior.heading is None else round(math.degrees(prior.heading), 6),
            heading_sd_deg=None if prior.heading is None else round(math.degrees(prior.heading_sd), 6),
        )


class SessionIn(In):
    """A session to open."""

    model_config = example(
        {
            "level_id": LEVEL_ID,
            "prior": PRIOR_EXAMPLE,
            "device_id": DEVICE_ID,
            "calibration_epoch": "bias-5f2c",
        }
    )

    level_id: LevelOfTrip = None
    venue_id: VenueOfTrip = None
    method: MethodName = DEFAULT_METHOD
    parameters: Parameters = Field(default_factory=dict)
    prior: PriorIn | None = None
    device_id: IdRef | None = None
    map_id: MapOfTrip = None
    map_ids: MapsOfTrip = ()
    calibration_epoch: Annotated[
        Epoch,
        Field(
            description=(
                "Any text that changes when the device's platform recalibrates its magnetometer, such as a hash of the "
                "hard-iron bias it reports. Needs `device_id`."
            )
        ),
    ] = ""
    contribute: Annotated[
        bool,
        Field(
            strict=True,
            description="Offer what the session saw to the maps of its levels when it is closed, in the name of the "
            "key that opened it; it counts only where independent contributors agree. No more than places and field "
            "is kept with the map. Ask the person who carries the device before you set this.",
        ),
    ] = False


class SessionOut(Out):
    """One trip of one device."""

    model_config = example(_SESSION)

    id: str
    venue_id: str
    level_id: Annotated[str | None, Field(description="Null: any level of the venue; each fix names its own.")]
    map_id: MapIdOut
    maps: MapsOut
    device_id: str | None
    method: str
    method_reason: MethodReason
    parameters: dict[str, Any]
    prior: PriorOut
    status: SessionStatus
    next_seq: Annotated[int, Field(description="Number of the segment that is expected next.")]
    created_at: Time
    closed_at: Time | None
    calibration_epoch: str
    contributes: Annotated[bool, Field(description="Whether it offers to maps what it saw.")]
    calibration: Annotated[
        CalibrationOut | None,
        Field(description="What earlier sessions taught about the device, used as this one began; null: nothing."),
    ]

    @classmethod
    def of(cls, session: records.Session) -> Self:
        """Show a session."""
        return cls(
            id=session.id,
            venue_id=session.venue_id,
            level_id=session.level_id,
            **maps_object(session.level_id, session.maps),
            device_id=session.device_id,
            method=session.method,
            method_reason=session.method_reason,
            parameters=dict(session.parameters),
            prior=PriorOut.of(session.prior),
            status=session.status,
            next_seq=session.next_seq,
            created_at=session.created_at,
            closed_at=session.closed_at,
            calibration_epoch=session.calibration_epoch,
            contributes=session.contributor is not None,
            calibration=session.prior.calibration and CalibrationOut.of(session.prior.calibration),
        )


class SessionPage(PageOut):
    """Sessions, newest first."""

    model_config = example({"items": [_SESSION], "next_cursor": None})

    items: list[SessionOut]
