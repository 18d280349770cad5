"""Where a session or one-shot location takes place, as requests name it and answers show it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any

from pydantic import Field

from app.api.schemas.base import IdRef, Out
from app.services.places import MAX_LEVELS
from app.services.records import LevelMap

LevelOfTrip = Annotated[IdRef | None, Field(description="The level. Send this or `venue_id`.")]
VenueOfTrip = Annotated[
    IdRef | None,
    Field(description="Any level of this venue that has a map: which one, is found. Send this or `level_id`."),
]
MapOfTrip = Annotated[IdRef | None, Field(description="A map version of the level; null: its current one.")]
MapsOfTrip = Annotated[
    tuple[IdRef, ...],
    Field(
        max_length=MAX_LEVELS,
        description="Map versions to use in place of the current ones, at most one a level; drafts too. Levels of the "
        "venue that none is named for keep their current map.",
    ),
]

MapIdOut = Annotated[
    str | None, Field(description="The map version of the level; null if any level was possible: see `maps`.")
]


class LevelMapOut(Out):
    """The map version that is used on a level."""

    level_id: str
    map_id: str


MapsOut = Annotated[list[LevelMapOut], Field(description="The map versions in use, one a level, lowest level first.")]


def maps_object(level_id: str | None, maps: Sequence[LevelMap]) -> dict[str, Any]:
    """The maps of a trip as every answer shows them: that of the level, and all of them."""
    return {
        "map_id": None if level_id is None else maps[0].map_id,
        "maps": [{"level_id": one.level_id, "map_id": one.map_id} for one in maps],
    }
