"""Recordings that phones push, and the markers that their annotations name."""

from __future__ import annotations

from typing import Annotated

from fastapi import Query, Request, Response

from app.api import errors
from app.api.auth import any_key, needs
from app.api.deps import ServicesDep
from app.api.pagination import PagingDep, link_next
from app.api.responses import OBJECT, guarded
from app.api.routing import api_router
from app.api.schemas.ingest import MarkersIn, MarkersOut, RecordingOut, RecordingPage, RecordingWaypointsIn
from app.services.ingest.records import Purpose, RecordingState
from app.services.records import Scope

router = api_router("ingest")


@router.get(
    "/v1/recordings", summary="List recordings", dependencies=[needs(Scope.LOCATE)], responses=guarded(errors.INVALID)
)
def list_recordings(
    services: ServicesDep,
    paging: PagingDep,
    request: Request,
    response: Response,
    token_id: Annotated[str | None, Query(description="Of this ingest token only.")] = None,
    device_id: Annotated[str | None, Query(description="Of this device only.")] = None,
    purpose: Annotated[Purpose | None, Query(description="For this purpose only.")] = None,
    state: Annotated[RecordingState | None, Query(description="In this state only.")] = None,
) -> RecordingPage:
    """Recordings, newest first."""
    page = services.recordings.list(
        token_id=token_id,
        device_id=device_id,
        purpose=purpose,
        state=state,
        cursor=paging.cursor,
        limit=paging.limit,
    )
    link_next(request, response, page.next_cursor)
    return RecordingPage(items=[RecordingOut.of(one) for one in page.items], next_cursor=page.next_cursor)


@router.get(
    "/v1/recordings/{recording_id}",
    summary="Read a recording",
    dependencies=[needs(Scope.LOCATE)],
    responses=guarded(errors.NOT_FOUND),
)
def get_recording(recording_id: str, services: ServicesDep) -> RecordingOut:
    """Where a recording stands, and what is wrong with it."""
    return RecordingOut.of(services.recordings.get(recording_id))


@router.post(
    "/v1/recordings/{recording_id}/close",
    summary="End a recording",
    dependencies=[needs(Scope.LOCATE)],
    responses=guarded(errors.NOT_FOUND, errors.OVERLOADED),
)
def close_recording(recording_id: str, services: ServicesDep) -> RecordingOut:
    """End it now instead of after a silence: its session is closed, or survey walks are made of it.

    Ending again changes nothing.
    """
    return RecordingOut.of(services.recordings.close(recording_id))


@router.put(
    "/v1/recordings/{recording_id}/waypoints",
    summary="Give a survey recording its waypoints",
    dependencies=[needs(Scope.SURVEY)],
    responses=guarded(*OBJECT, errors.NOT_FOUND, errors.CONFLICT),
)
def set_waypoints(recording_id: str, body: RecordingWaypointsIn, services: ServicesDep) -> RecordingOut:
    """Say where the phone was when: for a recording that is `waiting`, in place of its annotations."""
    return RecordingOut.of(services.recordings.set_waypoints(recording_id, body.waypoints()))


@router.get(
    "/v1/levels/{level_id}/markers",
    summary="Read the markers of a level",
    dependencies=[any_key()],
    responses=guarded(errors.NOT_FOUND),
)
def get_markers(level_id: str, services: ServicesDep) -> MarkersOut:
    """Marked points, by name."""
    return MarkersOut.of(services.recordings.markers(level_id))


@router.put(
    "/v1/levels/{level_id}/markers",
    summary="Set the markers of a level",
    dependencies=[needs(Scope.SURVEY)],
    responses=guarded(*OBJECT, errors.NOT_FOUND),
)
def put_markers(level_id: str, body: MarkersIn, services: ServicesDep) -> MarkersOut:
    """Put these marked points in place of what the level had. Names are the same whatever their case."""
    return MarkersOut.of(services.recordings.set_markers(level_id, body.records()))
