"""Venues."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import Field

from app.api.schemas.base import Distance, In, Name, Number, Out, PageOut, Time, example
from app.services import records
from app.services.records import VenueKind

_ANCHOR = {"latitude_deg": 48.1507, "longitude_deg": 11.5691, "bearing_deg": 12.5, "height_m": 515.0}
VENUE_ID = "ven_019ab2c4d1e07f3a9b2c4d5e6f"
_VENUE = {
    "id": VENUE_ID,
    "name": "Central Mall",
    "kind": "indoor",
    "anchor": _ANCHOR,
    "created_at": "2026-11-22T09:30:00.000Z",
    "updated_at": "2026-11-22T09:30:00.000Z",
}


class AnchorIn(In):
    """Takes the level frame to WGS 84."""

    latitude_deg: Annotated[Number, Field(ge=-89.9, le=89.9, description="Of the frame's origin.")]
    longitude_deg: Annotated[Number, Field(ge=-180, le=180)]
    bearing_deg: Annotated[Number, Field(ge=-360, le=360, description="Of +y, clockwise from true north.")] = 0.0
    height_m: Annotated[Number, Field(ge=-500, le=9000, description="Of level 0 above the ellipsoid.")] = 0.0

    def record(self) -> records.Anchor:
        """Return what the services take."""
        return records.Anchor(self.latitude_deg, self.longitude_deg, self.bearing_deg, self.height_m)


class AnchorOut(Out):
    """Takes the level frame to WGS 84: its origin, and the bearing of +y clockwise from north."""

    latitude_deg: float
    longitude_deg: float
    bearing_deg: float
    height_m: float


class VenueIn(In):
    """A venue to create."""

    model_config = example({"name": "Central Mall", "kind": "indoor", "anchor": _ANCHOR})

    name: Name
    kind: VenueKind = VenueKind.INDOOR
    anchor: Annotated[
        AnchorIn | None, Field(description="Needed for positions in WGS 84, and for segments with `gnss`.")
    ] = None


class VenuePatch(In):
    """What to change of a venue; what is not sent stays, `"anchor": null` takes the anchor away."""

    model_config = example({"name": "Central Mall, east wing"})

    name: Name | None = None
    anchor: AnchorIn | None = None


class VenueOut(Out):
    """A place with one local frame."""

    model_config = example(_VENUE)

    id: str
    name: str
    kind: VenueKind
    anchor: AnchorOut | None
    created_at: Time
    updated_at: Time

    @classmethod
    def of(cls, venue: records.Venue) -> Self:
        """Show a venue."""
        anchor = venue.anchor and AnchorOut(
            latitude_deg=venue.anchor.latitude_deg,
            longitude_deg=venue.anchor.longitude_deg,
            bearing_deg=venue.anchor.bearing_deg,
            height_m=venue.anchor.height_m,
        )
        return cls(
            id=venue.id,
            name=venue.name,
            kind=venue.kind,
            anchor=anchor,
            created_at=venue.created_at,
            updated_at=venue.updated_at,
        )


class VenueFoundOut(VenueOut):
    """A venue of a list."""

    model_config = example({**_VENUE, "distance_m": None})

    distance_m: Distance = None

    @classmethod
    def found(cls, one: records.Found[records.Venue]) -> Self:
        """Show a venue that was looked for."""
        return cls(**VenueOut.of(one.item).model_dump(), distance_m=one.distance_m and round(one.distance_m, 2))


class VenuePage(PageOut):
    """Venues, newest first, or nearest first where a place was named."""

    model_config = example({"items": [{**_VENUE, "distance_m": None}], "next_cursor": None})

    items: list[VenueFoundOut]
