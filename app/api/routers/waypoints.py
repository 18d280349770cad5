"""Where a level was walked."""

from __future__ import annotations

from typing import Annotated

from fastapi import Query, Request, Response

from app.api import errors
from app.api.auth import needs
from app.api.deps import ServicesDep
from app.api.pagination import PagingDep, link_next
from app.api.responses import guarded
from app.api.routing import api_router
from app.api.schemas.waypoints import WalkTrackOut, WalkTrackPage
from app.services.records import Scope

router = api_router("surveys")


@router.get(
    "/v1/levels/{level_id}/waypoints",
    summary="List where a level was walked",
    dependencies=[needs(Scope.SURVEY)],
    responses=guarded(errors.NOT_FOUND, errors.INVALID),
)
def list_waypoints(
    level_id: str,
    services: ServicesDep,
    paging: PagingDep,
    request: Request,
    response: Response,
    survey_id: Annotated[str | None, Query(description="Of this survey only.")] = None,
) -> WalkTrackPage:
    """The waypoints of all survey walks of a level, oldest walk first: what a plan of the survey shows."""
    page = services.surveys.list_tracks(level_id, paging.cursor, paging.limit, survey_id=survey_id)
    link_next(request, response, page.next_cursor)
    return WalkTrackPage(items=[WalkTrackOut.of(one) for one in page.items], next_cursor=page.next_cursor)
