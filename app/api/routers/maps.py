"""Maps: builds, versions, rasters, coverage."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated

from fastapi import Query, Request, Response
from starlette.concurrency import run_in_threadpool

from app.api import errors, rendering
from app.api.auth import any_key, needs
from app.api.deps import PREFER_PARAMETER, ContextDep, KeyDep, ServicesDep, WaitDep
from app.api.etag import IMMUTABLE, headers, not_modified, tag, tagged
from app.api.pagination import PagingDep, link_next
from app.api.rendering import Channel, Statistic
from app.api.responses import NOT_MODIFIED, OBJECT, PNG, RAW, guarded, raster_answer
from app.api.routing import api_router
from app.api.schemas.jobs import JobOut
from app.api.schemas.maps import CoverageOut, MapIn, MapOut, MapPage
from app.engine.types import GridMap, MapBuildSettings
from app.services.errors import InvalidError
from app.services.records import MapKind, NewBuild, Scope

router = api_router("maps")

SETTINGS = frozenset({"features", "cell_m", "mapped_m", "align"})
"""What an update takes from the current map."""


class FieldFormat(StrEnum):
    """How a raster is answered."""

    PNG = "png"
    F32 = "f32"


class CoverageFormat(StrEnum):
    """How coverage is answered."""

    JSON = "json"
    PNG = "png"


@router.post(
    "/v1/maps",
    status_code=202,
    summary="Build a map",
    dependencies=[needs(Scope.SURVEY)],
    response_model=JobOut,
    responses={
        200: {"model": JobOut, "description": "With `Prefer: wait=N`: the job ended in time (see its `state`)."},
        **guarded(*OBJECT, errors.NOT_FOUND, errors.CONFLICT),
    },
    openapi_extra={"parameters": [PREFER_PARAMETER]},
)
async def build_map(body: MapIn, context: ContextDep, wait: WaitDep, key: KeyDep) -> Response:
    """Queue the building of a level's next map version; the job's `result` will name it (`map_id`)."""
    given = sorted(body.model_fields_set & SETTINGS) if body.mode is MapKind.UPDATE else []
    if given:
        raise InvalidError(given[0], "is what the current map was built with", "leave it out, or order a build")
    settings = MapBuildSettings(features=body.features, cell_m=body.cell_m, mapped_m=body.mapped_m, align=body.align)
    new = NewBuild(body.level_id, settings, body.survey_ids, body.mode, publish=body.publish, key_id=key.id)
    job = await run_in_threadpool(context.services.maps.request_build, new)
    finished = await context.broker.wait(job.id, wait.seconds) if wait.seconds else None
    return Response(
        JobOut.of(finished or job).model_dump_json(),
        status_code=200 if finished else 202,
        media_type="application/json",
        headers={"Location": f"/v1/jobs/{job.id}", **(wait.applied if finished else {})},
    )


@router.get(
    "/v1/maps",
    summary="List map versions",
    dependencies=[any_key()],
    responses=guarded(errors.NOT_FOUND, errors.INVALID),
)
def list_maps(
    services: ServicesDep,
    paging: PagingDep,
    request: Request,
    response: Response,
    level_id: Annotated[str | None, Query(description="Of this level only.")] = None,
) -> MapPage:
    """Map versions, newest first."""
    page = services.maps.list(level_id, paging.cursor, paging.limit)
    link_next(request, response, page.next_cursor)
    return MapPage(items=[MapOut.of(info) for info in page.items], next_cursor=page.next_cursor)


@router.get(
    "/v1/maps/{map_id}",
    summary="Read a map version",
    dependencies=[any_key()],
    response_model=MapOut,
    responses={**NOT_MODIFIED, **guarded(errors.NOT_FOUND)},
)
def get_map(map_id: str, request: Request, services: ServicesDep) -> Response:
    """One map version without its cells. It never changes; the ETag is its content hash."""
    info = services.maps.get(map_id)
    entity_tag = tag(info.hash)
    return not_modified(request, entity_tag, IMMUTABLE) or tagged(
        MapOut.of(info).model_dump_json().encode(), "application/json", entity_tag, IMMUTABLE
    )


@router.get(
    "/v1/maps/{map_id}/field",
    summary="Read a raster of the field",
    dependencies=[any_key()],
    response_class=Response,
    responses={
        200: raster_answer("The raster, with its place in `X-Isodyn-*` headers."),
        **NOT_MODIFIED,
        **guarded(errors.NOT_FOUND, errors.INVALID),
    },
)
def get_field(
    map_id: str,
    request: Request,
    services: ServicesDep,
    channel: Annotated[
        Channel, Query(description="`h` and `v`: horizontal and vertical; which exist: see features.")
    ] = Channel.TOTAL,
    statistic: Annotated[
        Statistic, Query(description="`support`: metres to the nearest survey sample.")
    ] = Statistic.MEAN,
    format: Annotated[FieldFormat, Query(description="`png`, or `f32`: raw.")] = FieldFormat.PNG,  # noqa: A002
    low: Annotated[
        float | None, Query(ge=-1e6, le=1e6, allow_inf_nan=False, description="PNG: value of the first colour.")
    ] = None,
    high: Annotated[
        float | None, Query(ge=-1e6, le=1e6, allow_inf_nan=False, description="PNG: value of the last colour.")
    ] = None,
) -> Response:
    """One channel of a map, in microtesla.

    `png`: one pixel a node, north up, transparent where there is no map; colours run from the 1st to the 99th
    percentile unless `low` and `high` are given. `f32`: little-endian float32, row by row from the lowest y, NaN where
    there is no map (`support` is finite everywhere).
    """
    info = services.maps.get(map_id)
    entity_tag = tag(info.hash, channel, statistic, format, f"{low}", f"{high}")
    unchanged = not_modified(request, entity_tag, IMMUTABLE)
    if unchanged is not None:
        return unchanged
    grid = services.maps.grid(map_id)
    values = rendering.field(grid, channel, statistic)
    place = _place(grid)
    if format is FieldFormat.F32:
        return tagged(rendering.raw(values), RAW, entity_tag, IMMUTABLE, place)
    shown = rendering.colour_range(values, low, high)
    return tagged(rendering.png(values, shown), PNG, entity_tag, IMMUTABLE, {**place, **rendering.legend(shown)})


@router.get(
    "/v1/maps/{map_id}/coverage",
    summary="Read where a map is mapped",
    dependencies=[any_key()],
    response_model=CoverageOut,
    responses={
        200: {
            "description": "Shares and run lengths, or an image.",
            "content": {PNG: {"schema": {"type": "string", "contentMediaType": PNG}}},
        },
        **NOT_MODIFIED,
        **guarded(errors.NOT_FOUND, errors.INVALID),
    },
)
def get_coverage(
    map_id: str,
    request: Request,
    services: ServicesDep,
    format: Annotated[CoverageFormat, Query(description="`json` or `png`.")] = CoverageFormat.JSON,  # noqa: A002
) -> Response:
    """Which nodes are mapped: as run lengths (row by row from the lowest y, unmapped first) or as a PNG, north up."""
    info = services.maps.get(map_id)
    entity_tag = tag(info.hash, "coverage", format)
    unchanged = not_modified(request, entity_tag, IMMUTABLE)
    if unchanged is not None:
        return unchanged
    grid = services.maps.grid(map_id)
    if format is CoverageFormat.PNG:
        return tagged(rendering.coverage_png(grid.mapped), PNG, entity_tag, IMMUTABLE, _place(grid))
    rows, columns = grid.shape
    coverage = CoverageOut(
        map_id=map_id,
        rows=rows,
        columns=columns,
        x0=grid.x0,
        y0=grid.y0,
        cell_m=grid.cell_m,
        mapped_m=grid.mapped_m,
        mapped_share=info.mapped_share,
        mapped_area_m2=info.mapped_area_m2,
        runs=rendering.run_lengths(grid.mapped),
    )
    return Response(coverage.model_dump_json(), media_type="application/json", headers=headers(entity_tag, IMMUTABLE))


def _place(grid: GridMap) -> dict[str, str]:
    return rendering.place_headers(grid.shape, grid.x0, grid.y0, grid.cell_m)
