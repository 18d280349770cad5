"""Levels and their plans."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

import anyio
from fastapi import Query, Request, Response
from starlette.concurrency import run_in_threadpool

from app.api import errors
from app.api.auth import any_key, needs
from app.api.body import JSON, decode_json, read_body, require_media_type
from app.api.deps import ContextDep, ServicesDep
from app.api.errors import RejectedError
from app.api.etag import REVALIDATE, content_tag, not_modified, tagged
from app.api.geojson import GEO_JSON, plan_fault
from app.api.idempotency import IDEMPOTENCY_PARAMETER, CreationDep
from app.api.pagination import PagingDep, link_next
from app.api.rendering import png_size
from app.api.responses import NOT_MODIFIED, OBJECT, binary, guarded
from app.api.routing import api_router
from app.api.schemas.levels import PLAN_EXAMPLE, LevelFoundOut, LevelIn, LevelOut, LevelPage, LevelPatch
from app.api.search import SearchDep
from app.api.structure import PLAN_BOUNDS
from app.api.validation import FieldError
from app.services.records import Scope

router = api_router("levels")

PNG = "image/png"
_MAX_PIXELS = 50_000_000
_PLAN_SCHEMA = {"type": "object", "description": "A GeoJSON FeatureCollection in level metres."}


@router.post(
    "/v1/venues/{venue_id}/levels",
    status_code=201,
    summary="Create a level",
    dependencies=[needs(Scope.SURVEY)],
    responses=guarded(*OBJECT, errors.NOT_FOUND, errors.IDEMPOTENCY_REUSE),
    openapi_extra={"parameters": [IDEMPOTENCY_PARAMETER]},
)
def create_level(
    venue_id: str, body: LevelIn, services: ServicesDep, creation: CreationDep, response: Response
) -> LevelOut:
    """Create a storey; its extent is a rectangle in plan metres."""
    level = creation.once(
        lambda: services.venues.create_level(venue_id, body.name, body.ordinal, body.extent.corners()),
        services.venues.get_level,
    )
    response.headers["Location"] = f"/v1/levels/{level.id}"
    return LevelOut.of(level)


@router.get(
    "/v1/levels",
    summary="List levels",
    dependencies=[any_key()],
    responses=guarded(errors.NOT_FOUND, errors.INVALID),
)
def list_levels(
    services: ServicesDep,
    paging: PagingDep,
    request: Request,
    response: Response,
    search: SearchDep,
    venue_id: Annotated[str | None, Query(description="Of this venue only.")] = None,
    ordinal: Annotated[int | None, Query(ge=-100, le=1000, description="Of this height order only.")] = None,
) -> LevelPage:
    """Levels, newest first, or with `near` nearest first."""
    page = services.search.levels(replace(search, ordinal=ordinal), venue_id, paging.cursor, paging.limit)
    link_next(request, response, page.next_cursor)
    items = [LevelFoundOut.found(one) for one in page.items]
    return LevelPage(items=items, next_cursor=page.next_cursor)


@router.get(
    "/v1/levels/{level_id}", summary="Read a level", dependencies=[any_key()], responses=guarded(errors.NOT_FOUND)
)
def get_level(level_id: str, services: ServicesDep) -> LevelOut:
    """One level."""
    return LevelOut.of(services.venues.get_level(level_id))


@router.patch(
    "/v1/levels/{level_id}",
    summary="Change a level",
    dependencies=[needs(Scope.SURVEY)],
    responses=guarded(*OBJECT, errors.NOT_FOUND),
)
def update_level(level_id: str, body: LevelPatch, services: ServicesDep) -> LevelOut:
    """Change name, storey or extent; what is not sent stays as it is.

    Walks and maps stay where they are in level metres. The plan image's edges are those of the extent, so it is
    stretched with it: send it anew if it should not be.
    """
    level = services.venues.get_level(level_id)
    changed = services.venues.update_level(
        level_id,
        name=level.name if body.name is None else body.name,
        ordinal=level.ordinal if body.ordinal is None else body.ordinal,
        extent=level.extent if body.extent is None else body.extent.corners(),
    )
    return LevelOut.of(changed)


@router.put(
    "/v1/levels/{level_id}/plan.png",
    status_code=204,
    summary="Set the plan image",
    dependencies=[needs(Scope.SURVEY)],
    responses=guarded(*OBJECT, errors.NOT_FOUND),
    openapi_extra={"requestBody": {"required": True, "content": binary(PNG, "")["content"]}},
)
async def set_plan_image(level_id: str, request: Request, context: ContextDep) -> Response:
    """Store the raster plan; its edges are those of the level's extent, north up."""
    require_media_type(request, PNG)
    png = await read_body(request, context.settings.max_body_bytes)
    await run_in_threadpool(_check_png, png)
    await run_in_threadpool(context.services.venues.set_plan_image, level_id, png)
    return Response(status_code=204)


@router.get(
    "/v1/levels/{level_id}/plan.png",
    summary="Read the plan image",
    dependencies=[any_key()],
    response_class=Response,
    responses={200: binary(PNG, "The image."), **NOT_MODIFIED, **guarded(errors.NOT_FOUND)},
)
def get_plan_image(level_id: str, request: Request, services: ServicesDep) -> Response:
    """Return the raster plan as it was sent."""
    png = services.venues.plan_image(level_id)
    tag = content_tag(png)
    return not_modified(request, tag, REVALIDATE) or tagged(png, PNG, tag, REVALIDATE)


@router.put(
    "/v1/levels/{level_id}/plan.geojson",
    status_code=204,
    summary="Set the vector plan",
    dependencies=[needs(Scope.SURVEY)],
    responses=guarded(*OBJECT, errors.NOT_FOUND),
    openapi_extra={
        "requestBody": {
            "required": True,
            "content": {GEO_JSON: {"schema": _PLAN_SCHEMA, "example": PLAN_EXAMPLE}},
        }
    },
)
async def set_vector_plan(level_id: str, request: Request, context: ContextDep) -> Response:
    """Store the vector plan: a GeoJSON FeatureCollection whose coordinates are level metres, not degrees."""
    require_media_type(request, JSON)
    body = await read_body(request, context.settings.max_body_bytes)
    # A plan in memory is many times its text: few at once.
    await anyio.to_thread.run_sync(_check_plan, body, limiter=context.uploads)
    await run_in_threadpool(context.services.venues.set_vector_plan, level_id, body)
    return Response(status_code=204)


@router.get(
    "/v1/levels/{level_id}/plan.geojson",
    summary="Read the vector plan",
    dependencies=[any_key()],
    response_class=Response,
    responses={
        200: {
            "description": "The plan.",
            "content": {GEO_JSON: {"schema": _PLAN_SCHEMA, "example": PLAN_EXAMPLE}},
        },
        **NOT_MODIFIED,
        **guarded(errors.NOT_FOUND),
    },
)
def get_vector_plan(level_id: str, request: Request, services: ServicesDep) -> Response:
    """Return the vector plan, in level metres."""
    plan = services.venues.vector_plan(level_id)
    tag = content_tag(plan)
    return not_modified(request, tag, REVALIDATE) or tagged(plan, GEO_JSON, tag, REVALIDATE)


def _check_png(png: bytes) -> None:
    size = png_size(png)
    if size is None:
        raise RejectedError([FieldError("body", "is not a PNG image", "send a complete PNG")])
    if size[0] * size[1] > _MAX_PIXELS:
        raise RejectedError(
            [FieldError("body", f"has {size[0]} x {size[1]} pixels", f"send at most {_MAX_PIXELS} pixels")]
        )


def _check_plan(body: bytes) -> None:
    # Kept as it was sent, so it must be JSON to everybody: no NaN.
    fault = plan_fault(decode_json(body, PLAN_BOUNDS, non_finite=False))
    if fault is not None:
        field, message = fault
        raise RejectedError([FieldError(field, message, "send a GeoJSON FeatureCollection in level metres")])
