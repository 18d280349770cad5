"""Surveys and their walks."""

from __future__ import annotations

from typing import Annotated

import anyio
from fastapi import Query, Request, Response

from app.api import errors
from app.api.auth import needs
from app.api.body import UPLOAD_TYPES, media_type, read_body, require_media_type
from app.api.deps import Context, ContextDep, ServicesDep
from app.api.idempotency import IDEMPOTENCY_PARAMETER, CreationDep
from app.api.pagination import PagingDep, link_next
from app.api.responses import OBJECT, guarded, upload
from app.api.routing import api_router
from app.api.schemas.samples import WALK_EXAMPLE, WalkIn
from app.api.schemas.surveys import SurveyIn, SurveyOut, SurveyPage, WalkOut, WalkPage
from app.api.structure import WALK_BOUNDS
from app.api.uploads import new_walk, parse
from app.services.records import Scope

router = api_router("surveys")


@router.post(
    "/v1/surveys",
    status_code=201,
    summary="Create a survey",
    dependencies=[needs(Scope.SURVEY)],
    responses=guarded(*OBJECT, errors.NOT_FOUND, errors.IDEMPOTENCY_REUSE),
    openapi_extra={"parameters": [IDEMPOTENCY_PARAMETER]},
)
def create_survey(body: SurveyIn, services: ServicesDep, creation: CreationDep, response: Response) -> SurveyOut:
    """Open a survey of a level, to upload walks into."""
    survey = creation.once(lambda: services.surveys.create(body.level_id, body.name), services.surveys.get)
    response.headers["Location"] = f"/v1/surveys/{survey.id}"
    return SurveyOut.of(survey)


@router.get(
    "/v1/surveys",
    summary="List surveys",
    dependencies=[needs(Scope.SURVEY)],
    responses=guarded(errors.NOT_FOUND, errors.INVALID),
)
def list_surveys(
    services: ServicesDep,
    paging: PagingDep,
    request: Request,
    response: Response,
    level_id: Annotated[str | None, Query(description="Of this level only.")] = None,
) -> SurveyPage:
    """Surveys, newest first."""
    page = services.surveys.list(level_id, paging.cursor, paging.limit)
    link_next(request, response, page.next_cursor)
    return SurveyPage(items=[SurveyOut.of(survey) for survey in page.items], next_cursor=page.next_cursor)


@router.get(
    "/v1/surveys/{survey_id}",
    summary="Read a survey",
    dependencies=[needs(Scope.SURVEY)],
    responses=guarded(errors.NOT_FOUND),
)
def get_survey(survey_id: str, services: ServicesDep) -> SurveyOut:
    """One survey."""
    return SurveyOut.of(services.surveys.get(survey_id))


@router.post(
    "/v1/surveys/{survey_id}/walks",
    status_code=201,
    summary="Upload a survey walk",
    dependencies=[needs(Scope.SURVEY)],
    response_model=WalkOut,
    responses={
        200: {"model": WalkOut, "description": "The same samples and waypoints are there already."},
        **guarded(*OBJECT, errors.NOT_FOUND),
    },
    openapi_extra=upload(WalkIn, WALK_EXAMPLE),
)
async def add_walk(survey_id: str, request: Request, context: ContextDep) -> Response:
    """Upload samples with at least two waypoints; at most 30 minutes or 200,000 samples.

    Everything is checked before anything is stored. The same content again gives the walk that is there already.
    """
    require_media_type(request, *UPLOAD_TYPES)
    body = await read_body(request, context.settings.max_body_bytes)
    return await anyio.to_thread.run_sync(
        _add_walk, context, survey_id, body, media_type(request), limiter=context.uploads
    )


def _add_walk(context: Context, survey_id: str, body: bytes, kind: str) -> Response:
    services = context.services
    level = services.venues.get_level(services.surveys.get(survey_id).level_id)
    walk_in = parse(body, kind, WalkIn, WALK_BOUNDS)
    walk, repeated = services.surveys.add_walk(survey_id, new_walk(walk_in, level.extent, context.clock()))
    return Response(
        WalkOut.of(walk).model_dump_json(),
        status_code=200 if repeated else 201,
        media_type="application/json",
        headers={"Location": f"/v1/surveys/{survey_id}/walks/{walk.id}"},
    )


@router.get(
    "/v1/surveys/{survey_id}/walks",
    summary="List the walks of a survey",
    dependencies=[needs(Scope.SURVEY)],
    responses=guarded(errors.NOT_FOUND, errors.INVALID),
)
def list_walks(
    survey_id: str, services: ServicesDep, paging: PagingDep, request: Request, response: Response
) -> WalkPage:
    """Walks, oldest first."""
    page = services.surveys.list_walks(survey_id, paging.cursor, paging.limit)
    link_next(request, response, page.next_cursor)
    return WalkPage(items=[WalkOut.of(walk) for walk in page.items], next_cursor=page.next_cursor)


@router.get(
    "/v1/surveys/{survey_id}/walks/{walk_id}",
    summary="Read a walk",
    dependencies=[needs(Scope.SURVEY)],
    responses=guarded(errors.NOT_FOUND),
)
def get_walk(survey_id: str, walk_id: str, services: ServicesDep) -> WalkOut:
    """One walk, without its samples."""
    return WalkOut.of(services.surveys.get_walk(survey_id, walk_id))


@router.delete(
    "/v1/surveys/{survey_id}/walks/{walk_id}",
    status_code=204,
    summary="Delete a walk",
    dependencies=[needs(Scope.SURVEY)],
    responses=guarded(errors.NOT_FOUND),
)
def delete_walk(survey_id: str, walk_id: str, services: ServicesDep) -> None:
    """Delete a walk; maps built from it stay as they are."""
    services.surveys.delete_walk(survey_id, walk_id)
