"""One-shot location."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import ConfigDict, Field

from app.api.schemas.aids import AidsIn
from app.api.schemas.base import Out, example
from app.api.schemas.fixes import (
    FIXED_LAG,
    FIXES_EXAMPLE,
    POSITION_EXAMPLE,
    FixesOut,
    PositionOut,
    fix_columns,
    position_object,
)
from app.api.schemas.levels import LEVEL_ID
from app.api.schemas.maps import MAP_ID
from app.api.schemas.methods import MethodName, MethodReason
from app.api.schemas.places import LevelOfTrip, MapIdOut, MapOfTrip, MapsOut, VenueOfTrip, maps_object
from app.api.schemas.samples import SAMPLES_EXAMPLE, Frame, SamplesIn
from app.api.schemas.sessions import PRIOR_EXAMPLE, Parameters, PriorIn
from app.engine.localization.registry import DEFAULT_METHOD
from app.services.records import Located

LOCATE_EXAMPLE: dict[str, Any] = {"level_id": LEVEL_ID, "prior": PRIOR_EXAMPLE, "samples": SAMPLES_EXAMPLE}


class LocateIn(AidsIn):
    """Samples to locate at once, without a session."""

    model_config = ConfigDict(json_schema_extra={"examples": [LOCATE_EXAMPLE]})

    level_id: LevelOfTrip = None
    venue_id: VenueOfTrip = None
    method: MethodName = DEFAULT_METHOD
    parameters: Parameters = Field(default_factory=dict)
    prior: PriorIn | None = None
    map_id: MapOfTrip = None
    frame: Frame = Frame.ANDROID
    samples: SamplesIn


class LocateOut(Out):
    """The trajectory of the samples."""

    model_config = example(
        {
            "map_id": MAP_ID,
            "maps": [{"level_id": LEVEL_ID, "map_id": MAP_ID}],
            "method": DEFAULT_METHOD,
            "method_reason": None,
            "fixes": FIXES_EXAMPLE,
            "fixed_lag": {name: [] for name in FIXES_EXAMPLE},
            "position": POSITION_EXAMPLE,
        }
    )

    map_id: MapIdOut
    maps: MapsOut
    method: str
    method_reason: MethodReason
    fixes: FixesOut
    fixed_lag: Annotated[FixesOut, Field(description=FIXED_LAG)]
    position: Annotated[PositionOut | None, Field(description="The last fix.")]


def located_object(located: Located) -> dict[str, Any]:
    """Return the answer as plain values, the shape of LocateOut."""
    return {
        **maps_object(located.level_id, located.maps),
        "method": located.method,
        "method_reason": located.method_reason,
        "fixes": fix_columns(located.fixes),
        "fixed_lag": fix_columns(located.lagged),
        "position": position_object(located.fixes[-1]) if located.fixes else None,
    }
