"""Geofences and their events."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Annotated

from fastapi import Query, Request, Response

from app.api import errors
from app.api.auth import any_key, needs
from app.api.deps import ServicesDep
from app.api.geofence_csv import CSV, events_csv, wants_csv
from app.api.idempotency import IDEMPOTENCY_PARAMETER, CreationDep
from app.api.pagination import PagingDep, link_next, next_link
from app.api.responses import OBJECT, guarded
from app.api.routing import api_router
from app.api.schemas.geofences import (
    GeofenceEventOut,
    GeofenceEventPage,
    GeofenceIn,
    GeofenceOut,
    GeofencePage,
    GeofencePatch,
)
from app.services.geofence_records import EventFilter, GeofenceEventKind
from app.services.records import Scope

router = api_router("geofences")

_AFTER = "Fixes after this time only (ISO 8601; without an offset UTC)."
_BEFORE = "Fixes before this time only."


@router.post(
    "/v1/geofences",
    status_code=201,
    summary="Create a geofence",
    dependencies=[needs(Scope.SURVEY)],
    responses=guarded(*OBJECT, errors.NOT_FOUND, errors.CONFLICT, errors.IDEMPOTENCY_REUSE),
    openapi_extra={"parameters": [IDEMPOTENCY_PARAMETER]},
)
def create_geofence(body: GeofenceIn, services: ServicesDep, creation: CreationDep, response: Response) -> GeofenceOut:
    """Draw an area on a level. Sessions that enter, leave or dwell in it are told by events and webhooks."""
    geofence = creation.once(lambda: services.geofences.create(body.level_id, body.spec()), services.geofences.get)
    response.headers["Location"] = f"/v1/geofences/{geofence.id}"
    return GeofenceOut.of(geofence)


@router.get(
    "/v1/geofences",
    summary="List geofences",
    dependencies=[any_key()],
    responses=guarded(errors.NOT_FOUND, errors.INVALID),
)
def list_geofences(
    services: ServicesDep,
    paging: PagingDep,
    request: Request,
    response: Response,
    level_id: Annotated[str | None, Query(description="Of this level only.")] = None,
) -> GeofencePage:
    """Geofences, newest first."""
    page = services.geofences.list(level_id, paging.cursor, paging.limit)
    link_next(request, response, page.next_cursor)
    return GeofencePage(items=[GeofenceOut.of(one) for one in page.items], next_cursor=page.next_cursor)


@router.get(
    "/v1/geofences/{geofence_id}",
    summary="Read a geofence",
    dependencies=[any_key()],
    responses=guarded(errors.NOT_FOUND),
)
def get_geofence(geofence_id: str, services: ServicesDep) -> GeofenceOut:
    """One geofence."""
    return GeofenceOut.of(services.geofences.get(geofence_id))


@router.patch(
    "/v1/geofences/{geofence_id}",
    summary="Change a geofence",
    dependencies=[needs(Scope.SURVEY)],
    responses=guarded(*OBJECT, errors.NOT_FOUND),
)
def update_geofence(geofence_id: str, body: GeofencePatch, services: ServicesDep) -> GeofenceOut:
    """Change what is sent; the level stays. Who is inside stays so until its next fix says otherwise."""
    spec = body.spec(services.geofences.get(geofence_id))
    return GeofenceOut.of(services.geofences.update(geofence_id, spec))


@router.delete(
    "/v1/geofences/{geofence_id}",
    status_code=204,
    summary="Delete a geofence",
    dependencies=[needs(Scope.SURVEY)],
    responses=guarded(errors.NOT_FOUND),
)
def delete_geofence(geofence_id: str, services: ServicesDep) -> None:
    """Delete a geofence; sessions inside leave it (`geofence deleted`). Its events are kept."""
    services.geofences.delete(geofence_id)


@router.get(
    "/v1/geofence-events",
    summary="List events of geofences",
    dependencies=[needs(Scope.LOCATE)],
    response_model=GeofenceEventPage,
    responses={
        200: {
            "description": "Objects, or with `Accept: text/csv` a table; the `Link` header leads on.",
            "content": {CSV: {"schema": {"type": "string"}}},
        },
        **guarded(errors.INVALID),
    },
)
def list_geofence_events(
    services: ServicesDep,
    paging: PagingDep,
    request: Request,
    geofence_id: Annotated[
        str | None, Query(description="Of this geofence only; also of one that was deleted.")
    ] = None,
    session_id: Annotated[str | None, Query(description="Of this session only.")] = None,
    level_id: Annotated[str | None, Query(description="On this level only.")] = None,
    kind: Annotated[GeofenceEventKind | None, Query(description="Of this kind only.")] = None,
    after: Annotated[datetime | None, Query(description=_AFTER)] = None,
    before: Annotated[datetime | None, Query(description=_BEFORE)] = None,
) -> Response:
    """Who entered, left or dwelt in a geofence, newest first."""
    wanted = EventFilter(geofence_id, session_id, level_id, kind, _utc(after), _utc(before))
    page = services.geofences.events(wanted, paging.cursor, paging.limit)
    headers = {"Vary": "Accept"}
    if page.next_cursor is not None:
        headers["Link"] = next_link(request, page.next_cursor)
    if wants_csv(request):
        return Response(events_csv(page.items), media_type=CSV, headers=headers)
    shown = GeofenceEventPage(items=[GeofenceEventOut.of(one) for one in page.items], next_cursor=page.next_cursor)
    return Response(shown.model_dump_json(), media_type="application/json", headers=headers)


def _utc(value: datetime | None) -> datetime | None:
    return value if value is None or value.tzinfo is not None else value.replace(tzinfo=UTC)
