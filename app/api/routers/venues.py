"""Venues."""

from __future__ import annotations

from fastapi import Request, Response

from app.api import errors
from app.api.auth import any_key, needs
from app.api.deps import ServicesDep
from app.api.idempotency import IDEMPOTENCY_PARAMETER, CreationDep
from app.api.pagination import PagingDep, link_next
from app.api.responses import OBJECT, guarded
from app.api.routing import api_router
from app.api.schemas.venues import VenueFoundOut, VenueIn, VenueOut, VenuePage, VenuePatch
from app.api.search import SearchDep
from app.services.records import Scope

router = api_router("venues")


@router.post(
    "/v1/venues",
    status_code=201,
    summary="Create a venue",
    dependencies=[needs(Scope.SURVEY)],
    responses=guarded(*OBJECT, errors.IDEMPOTENCY_REUSE),
    openapi_extra={"parameters": [IDEMPOTENCY_PARAMETER]},
)
def create_venue(body: VenueIn, services: ServicesDep, creation: CreationDep, response: Response) -> VenueOut:
    """Create a place with one local frame; its storeys are levels."""
    anchor = body.anchor.record() if body.anchor else None
    venue = creation.once(lambda: services.venues.create(body.name, body.kind, anchor), services.venues.get)
    response.headers["Location"] = f"/v1/venues/{venue.id}"
    return VenueOut.of(venue)


@router.get("/v1/venues", summary="List venues", dependencies=[any_key()], responses=guarded(errors.INVALID))
def list_venues(
    services: ServicesDep, paging: PagingDep, request: Request, response: Response, search: SearchDep
) -> VenuePage:
    """Venues, newest first, or with `near` nearest first."""
    page = services.search.venues(search, paging.cursor, paging.limit)
    link_next(request, response, page.next_cursor)
    items = [VenueFoundOut.found(one) for one in page.items]
    return VenuePage(items=items, next_cursor=page.next_cursor)


@router.get(
    "/v1/venues/{venue_id}",
    summary="Read a venue",
    dependencies=[any_key()],
    responses=guarded(errors.NOT_FOUND),
)
def get_venue(venue_id: str, services: ServicesDep) -> VenueOut:
    """One venue."""
    return VenueOut.of(services.venues.get(venue_id))


@router.patch(
    "/v1/venues/{venue_id}",
    summary="Change a venue",
    dependencies=[needs(Scope.SURVEY)],
    responses=guarded(*OBJECT, errors.NOT_FOUND),
)
def update_venue(venue_id: str, body: VenuePatch, services: ServicesDep) -> VenueOut:
    """Change name or anchor; what is not sent stays as it is, `"anchor": null` takes the anchor away."""
    venue = services.venues.get(venue_id)
    anchor = body.anchor.record() if body.anchor else None
    changed = services.venues.update(
        venue_id,
        name=venue.name if body.name is None else body.name,
        anchor=anchor if "anchor" in body.model_fields_set else venue.anchor,
    )
    return VenueOut.of(changed)


@router.delete(
    "/v1/venues/{venue_id}",
    status_code=204,
    summary="Delete a venue",
    dependencies=[needs(Scope.SURVEY)],
    responses=guarded(errors.NOT_FOUND, errors.CONFLICT),
)
def delete_venue(venue_id: str, services: ServicesDep) -> None:
    """Delete a venue that has no levels."""
    services.venues.delete(venue_id)
