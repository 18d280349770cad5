"""Known positions of sessions, and what was told there."""

from __future__ import annotations

from fastapi import Request, Response

from app.api import errors
from app.api.auth import needs
from app.api.deps import ServicesDep
from app.api.pagination import PagingDep, link_next
from app.api.responses import OBJECT, guarded
from app.api.routing import api_router
from app.api.schemas.ground_truth import GroundTruthIn, GroundTruthPage
from app.services.records import Scope

router = api_router("sessions")
_PATH = "/v1/sessions/{session_id}/ground-truth"


@router.post(
    _PATH,
    status_code=201,
    summary="Add known positions of a session",
    dependencies=[needs(Scope.LOCATE)],
    responses=guarded(*OBJECT, errors.NOT_FOUND, errors.CONFLICT),
)
def add_ground_truth(session_id: str, body: GroundTruthIn, services: ServicesDep) -> GroundTruthPage:
    """Say where the device was at some times, for instance as it passed marked points.

    Each is compared with the session's fixes, at once or as soon as they come: error, and whether the 95 % ellipse held
    it. A point of the same `t_ms` as an earlier one takes its place. The session does not learn from it.
    """
    points = services.ground_truth.add(session_id, body.marks())
    return GroundTruthPage.of(points)


@router.get(
    _PATH,
    summary="List known positions of a session",
    dependencies=[needs(Scope.LOCATE)],
    responses=guarded(errors.NOT_FOUND, errors.INVALID),
)
def list_ground_truth(
    session_id: str, services: ServicesDep, paging: PagingDep, request: Request, response: Response
) -> GroundTruthPage:
    """Known positions with what was told there, oldest first."""
    page = services.ground_truth.list(session_id, paging.cursor, paging.limit)
    link_next(request, response, page.next_cursor)
    return GroundTruthPage.of(page.items, page.next_cursor)


@router.delete(
    _PATH,
    status_code=204,
    summary="Forget known positions of a session",
    dependencies=[needs(Scope.LOCATE)],
    responses=guarded(errors.NOT_FOUND),
)
def forget_ground_truth(session_id: str, services: ServicesDep) -> None:
    """Delete all of them, for instance because they were marked wrongly; statistics no longer count them."""
    services.ground_truth.forget(session_id)
