"""Contributions of sessions to maps: what became of them, and their review."""

from __future__ import annotations

from typing import Annotated

from fastapi import Query, Request, Response

from app.api import errors
from app.api.auth import needs
from app.api.deps import ServicesDep
from app.api.pagination import PagingDep, link_next
from app.api.responses import guarded
from app.api.routing import api_router
from app.api.schemas.contributions import ContributionOut, ContributionPage, LastingChangeOut, LastingChangePage
from app.services.records import ContributionState, Scope

router = api_router("contributions")


@router.get(
    "/v1/contributions",
    summary="List contributions",
    dependencies=[needs(Scope.SURVEY)],
    responses=guarded(errors.INVALID),
)
def list_contributions(
    services: ServicesDep,
    paging: PagingDep,
    request: Request,
    response: Response,
    level_id: Annotated[str | None, Query(description="To this level's map only.")] = None,
    session_id: Annotated[str | None, Query(description="Of this session only.")] = None,
    contributor: Annotated[str | None, Query(description="Of this key only.")] = None,
    state: Annotated[ContributionState | None, Query(description="In this state only.")] = None,
) -> ContributionPage:
    """What sessions offered to maps, newest first."""
    page = services.contributions.list(
        level_id=level_id,
        session_id=session_id,
        contributor=contributor,
        state=state,
        cursor=paging.cursor,
        limit=paging.limit,
    )
    link_next(request, response, page.next_cursor)
    return ContributionPage(items=[ContributionOut.of(one) for one in page.items], next_cursor=page.next_cursor)


@router.get(
    "/v1/contributions/{contribution_id}",
    summary="Read a contribution",
    dependencies=[needs(Scope.SURVEY)],
    responses=guarded(errors.NOT_FOUND),
)
def get_contribution(contribution_id: str, services: ServicesDep) -> ContributionOut:
    """One contribution, without its rows."""
    return ContributionOut.of(services.contributions.get(contribution_id))


@router.post(
    "/v1/contributions/{contribution_id}/reject",
    summary="Reject a contribution",
    dependencies=[needs(Scope.ADMIN)],
    responses=guarded(errors.NOT_FOUND),
)
def reject_contribution(contribution_id: str, services: ServicesDep) -> ContributionOut:
    """Take it out of the map, whatever the weighing says; the level's map is updated without it."""
    return ContributionOut.of(services.contributions.reject(contribution_id))


@router.post(
    "/v1/contributions/{contribution_id}/restore",
    summary="Restore a contribution",
    dependencies=[needs(Scope.ADMIN)],
    responses=guarded(errors.NOT_FOUND, errors.CONFLICT),
)
def restore_contribution(contribution_id: str, services: ServicesDep) -> ContributionOut:
    """Offer a rejected contribution again; what it counts for is found by weighing it."""
    return ContributionOut.of(services.contributions.restore(contribution_id))


@router.delete(
    "/v1/contributions/{contribution_id}",
    status_code=204,
    summary="Delete a contribution",
    dependencies=[needs(Scope.ADMIN)],
    responses=guarded(errors.NOT_FOUND),
)
def delete_contribution(contribution_id: str, services: ServicesDep) -> None:
    """Forget it for good; the level's map is updated without it. Older versions of the map stay as they are."""
    services.contributions.delete(contribution_id)


@router.get(
    "/v1/changes",
    summary="List changes of the field",
    dependencies=[needs(Scope.SURVEY)],
    responses=guarded(errors.INVALID),
)
def list_changes(
    services: ServicesDep,
    paging: PagingDep,
    request: Request,
    response: Response,
    level_id: Annotated[str | None, Query(description="Of this level only.")] = None,
) -> LastingChangePage:
    """Lasting changes of the field that independent passes agree on (a new lift, moved steel), newest first."""
    page = services.contributions.changes(level_id=level_id, cursor=paging.cursor, limit=paging.limit)
    link_next(request, response, page.next_cursor)
    return LastingChangePage(items=[LastingChangeOut.of(one) for one in page.items], next_cursor=page.next_cursor)
