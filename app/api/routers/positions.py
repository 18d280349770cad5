"""Positions of a session."""

from __future__ import annotations

from typing import Annotated, Literal

import orjson
from fastapi import Query, Request, Response

from app.api import errors
from app.api.auth import needs
from app.api.deps import ServicesDep
from app.api.errors import NoAnchorError
from app.api.geojson import GEO_JSON, feature_collection, wants_geo_json
from app.api.pagination import PagingDep, next_link
from app.api.responses import guarded, schema_of
from app.api.routing import api_router
from app.api.schemas.positions import GEO_JSON_EXAMPLE, PositionCollection, PositionPage, position_page
from app.api.schemas.samples import MAX_SEQ
from app.engine.types import FixKind
from app.services.container import Services
from app.services.records import Anchor, Scope

router = api_router("positions")

_KIND = (
    "`filtered`: as told in the moment. `fixed_lag`: each step once more, about 5 s later, with what came since. "
    "`smoothed` ones are the trajectory."
)


@router.get(
    "/v1/sessions/{session_id}/positions",
    summary="Read the positions of a session",
    dependencies=[needs(Scope.LOCATE)],
    response_model=PositionPage,
    responses={
        200: {
            "description": "Columns, or GeoJSON with `Accept: application/geo+json`.",
            "content": {
                GEO_JSON: {
                    "schema": schema_of(PositionCollection),
                    "example": GEO_JSON_EXAMPLE,
                }
            },
        },
        **guarded(errors.NOT_FOUND, errors.NO_ANCHOR, errors.INVALID),
    },
)
def list_positions(
    session_id: str,
    request: Request,
    services: ServicesDep,
    paging: PagingDep,
    seq: Annotated[int | None, Query(ge=0, le=MAX_SEQ, description="Told with this segment only.")] = None,
    kind: Annotated[Literal[FixKind.FILTERED, FixKind.FIXED_LAG], Query(description=_KIND)] = FixKind.FILTERED,
) -> Response:
    """Fixes of one kind, oldest segment first, a page at a time.

    With `Accept: application/geo+json` they are points in WGS 84, with level metres in the properties; the venue
    needs an anchor for that.
    """
    anchor = _anchor(services, session_id) if wants_geo_json(request) else None
    page = services.sessions.positions(session_id, seq, paging.cursor, paging.limit, kind=kind)
    headers = {"Vary": "Accept"}
    if page.next_cursor is not None:
        headers["Link"] = next_link(request, page.next_cursor)
    if anchor is None:
        content = position_page(page.items, page.next_cursor)
        return Response(orjson.dumps(content), media_type="application/json", headers=headers)
    collection = feature_collection(page.items, anchor, page.next_cursor)
    return Response(orjson.dumps(collection), media_type=GEO_JSON, headers=headers)


def _anchor(services: Services, session_id: str) -> Anchor:
    venue = services.venues.get(services.sessions.get(session_id).venue_id)
    if venue.anchor is None:
        raise NoAnchorError(f"venue {venue.id} has no anchor; PATCH /v1/venues/{venue.id} with one, or ask for JSON")
    return venue.anchor
