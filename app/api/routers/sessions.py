"""Sessions."""

from __future__ import annotations

from typing import Annotated

from fastapi import Query, Request, Response

from app.api import errors
from app.api.auth import needs
from app.api.deps import KeyDep, ServicesDep
from app.api.idempotency import IDEMPOTENCY_PARAMETER, CreationDep
from app.api.pagination import PagingDep, link_next
from app.api.responses import OBJECT, guarded
from app.api.routing import api_router
from app.api.schemas.sessions import SessionIn, SessionOut, SessionPage
from app.services.records import Scope, SessionStatus

router = api_router("sessions")


@router.post(
    "/v1/sessions",
    status_code=201,
    summary="Open a session",
    dependencies=[needs(Scope.LOCATE)],
    responses=guarded(*OBJECT, errors.NOT_FOUND, errors.NO_MAP, errors.IDEMPOTENCY_REUSE),
    openapi_extra={"parameters": [IDEMPOTENCY_PARAMETER]},
)
def create_session(
    body: SessionIn, services: ServicesDep, creation: CreationDep, key: KeyDep, response: Response
) -> SessionOut:
    """Open a session: one trip of one device, on a level or (level unknown) anywhere in a venue.

    Exactly one of `level_id` and `venue_id`. The level's current map (or `map_id`) is pinned to the session, or the
    current maps of all levels of the venue that have one (with `map_ids` in place of some).
    """
    session = creation.once(
        lambda: services.sessions.create(
            body.level_id,
            body.method,
            body.parameters,
            body.prior.prior() if body.prior else None,
            venue_id=body.venue_id,
            device_id=body.device_id,
            map_id=body.map_id,
            map_ids=body.map_ids,
            calibration_epoch=body.calibration_epoch,
            contributor=key.id if body.contribute else None,
        ),
        services.sessions.get,
    )
    response.headers["Location"] = f"/v1/sessions/{session.id}"
    return SessionOut.of(session)


@router.get(
    "/v1/sessions",
    summary="List sessions",
    dependencies=[needs(Scope.LOCATE)],
    responses=guarded(errors.INVALID),
)
def list_sessions(
    services: ServicesDep,
    paging: PagingDep,
    request: Request,
    response: Response,
    venue_id: Annotated[str | None, Query(description="Of this venue only.")] = None,
    level_id: Annotated[str | None, Query(description="Opened on this level only.")] = None,
    device_id: Annotated[str | None, Query(description="Of this device only.")] = None,
    status: Annotated[SessionStatus | None, Query(description="Only open or closed ones.")] = None,
) -> SessionPage:
    """Sessions, newest first."""
    page = services.sessions.list(level_id, device_id, status, paging.cursor, paging.limit, venue_id=venue_id)
    link_next(request, response, page.next_cursor)
    return SessionPage(items=[SessionOut.of(session) for session in page.items], next_cursor=page.next_cursor)


@router.get(
    "/v1/sessions/{session_id}",
    summary="Read a session",
    dependencies=[needs(Scope.LOCATE)],
    responses=guarded(errors.NOT_FOUND),
)
def get_session(session_id: str, services: ServicesDep) -> SessionOut:
    """One session."""
    return SessionOut.of(services.sessions.get(session_id))


@router.post(
    "/v1/sessions/{session_id}/close",
    summary="Close a session",
    dependencies=[needs(Scope.LOCATE)],
    responses=guarded(errors.NOT_FOUND),
)
def close_session(session_id: str, services: ServicesDep) -> SessionOut:
    """Take no more segments; those accepted are still processed. Closing again changes nothing.

    What the session learned about its device starts the device's next one.
    """
    return SessionOut.of(services.sessions.close(session_id))
