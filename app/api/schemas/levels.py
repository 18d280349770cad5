"""Levels and their plans."""

from __future__ import annotations

from typing import Annotated, Any, Self

from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from app.api.schemas.base import Distance, In, Integer, Metres, Name, Out, PageOut, Time, example
from app.api.schemas.venues import VENUE_ID
from app.services import records

LEVEL_ID = "lvl_019ab2c4d1e07f3a9b2c4d5e6f"
MAX_SIDE_M = 20_000.0
Ordinal = Annotated[Integer, Field(ge=-100, le=1000, description="Height order; 0 is the ground floor.")]
_EXTENT = {"x_min": 0.0, "y_min": 0.0, "x_max": 120.0, "y_max": 80.0}
_LEVEL = {
    "id": LEVEL_ID,
    "venue_id": VENUE_ID,
    "name": "F2",
    "ordinal": 1,
    "extent": _EXTENT,
    "has_plan_image": True,
    "has_vector_plan": False,
    "current_map_id": "map_019ab2c4d1e07f3a9b2c4d5e6f",
    "created_at": "2026-11-22T09:30:00.000Z",
    "updated_at": "2026-11-22T09:30:00.000Z",
}
PLAN_EXAMPLE: dict[str, Any] = {
    "type": "FeatureCollection",
    "features": [
        {
            "type": "Feature",
            "properties": {"kind": "wall"},
            "geometry": {"type": "LineString", "coordinates": [[0, 0], [12.5, 0], [12.5, 8]]},
        }
    ],
}


class ExtentIn(In):
    """A rectangle in plan metres."""

    x_min: Metres
    y_min: Metres
    x_max: Metres
    y_max: Metres

    def corners(self) -> tuple[float, float, float, float]:
        """Return what the services take."""
        return self.x_min, self.y_min, self.x_max, self.y_max

    @model_validator(mode="after")
    def _is_rectangle(self) -> Self:
        for low, high in (("x_min", "x_max"), ("y_min", "y_max")):
            side = getattr(self, high) - getattr(self, low)
            if not 0 < side <= MAX_SIDE_M:
                raise PydanticCustomError(
                    "extent",
                    "{high} - {low} is {side} m",
                    {
                        "high": high,
                        "low": low,
                        "side": f"{side:g}",
                        "remedy": f"give {low} < {high}, at most {MAX_SIDE_M:g} m apart",
                    },
                )
        return self


class ExtentOut(Out):
    """A rectangle in plan metres."""

    x_min: float
    y_min: float
    x_max: float
    y_max: float


class LevelIn(In):
    """A level to create."""

    model_config = example({"name": "F2", "ordinal": 1, "extent": _EXTENT})

    name: Name
    ordinal: Ordinal = 0
    extent: ExtentIn


class LevelPatch(In):
    """What to change of a level; what is not sent stays."""

    model_config = example({"name": "F2, east wing"})

    name: Name | None = None
    ordinal: Ordinal | None = None
    extent: ExtentIn | None = None


class LevelOut(Out):
    """One storey of a venue."""

    model_config = example(_LEVEL)

    id: str
    venue_id: str
    name: str
    ordinal: int
    extent: ExtentOut
    has_plan_image: bool
    has_vector_plan: bool
    current_map_id: Annotated[str | None, Field(description="What new sessions use.")]
    created_at: Time
    updated_at: Time

    @classmethod
    def of(cls, level: records.Level) -> Self:
        """Show a level."""
        x_min, y_min, x_max, y_max = level.extent
        return cls(
            id=level.id,
            venue_id=level.venue_id,
            name=level.name,
            ordinal=level.ordinal,
            extent=ExtentOut(x_min=x_min, y_min=y_min, x_max=x_max, y_max=y_max),
            has_plan_image=level.has_plan_image,
            has_vector_plan=level.has_vector_plan,
            current_map_id=level.current_map_id,
            created_at=level.created_at,
            updated_at=level.updated_at,
        )


class LevelFoundOut(LevelOut):
    """A level of a list."""

    model_config = example({**_LEVEL, "distance_m": None})

    distance_m: Distance = None

    @classmethod
    def found(cls, one: records.Found[records.Level]) -> Self:
        """Show a level that was looked for."""
        return cls(**LevelOut.of(one.item).model_dump(), distance_m=one.distance_m and round(one.distance_m, 2))


class LevelPage(PageOut):
    """Levels, newest first, or nearest first where a place was named."""

    model_config = example({"items": [{**_LEVEL, "distance_m": None}], "next_cursor": None})

    items: list[LevelFoundOut]
