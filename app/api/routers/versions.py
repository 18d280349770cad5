"""Versions of maps: publishing, who contributed, what changed."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated

import numpy as np
from fastapi import Query, Request, Response

from app.api import errors, rendering
from app.api.auth import any_key, needs
from app.api.deps import KeyDep, ServicesDep
from app.api.etag import IMMUTABLE, not_modified, tag, tagged
from app.api.pagination import PagingDep, link_next
from app.api.rendering import ColourRange
from app.api.responses import NOT_MODIFIED, OBJECT, PNG, RAW, guarded, raster_answer
from app.api.routing import api_router
from app.api.schemas.versions import (
    DiffOut,
    MapSourceOut,
    MapSourcePage,
    PublicationIn,
    PublicationOut,
    PublicationPage,
)
from app.engine.mapping.diff import LEAST_UT, SIGNIFICANT, Component
from app.engine.types import Float32Array
from app.services.records import Scope

router = api_router("maps")


class DiffFormat(StrEnum):
    """How a difference is answered."""

    JSON = "json"
    PNG = "png"
    F32 = "f32"


class DiffStatistic(StrEnum):
    """What a raster shows."""

    CHANGE = "change"
    SIGNIFICANCE = "significance"


@router.put(
    "/v1/levels/{level_id}/map",
    summary="Publish a map version",
    dependencies=[needs(Scope.SURVEY)],
    responses=guarded(*OBJECT, errors.NOT_FOUND),
)
def publish_map(level_id: str, body: PublicationIn, services: ServicesDep, key: KeyDep) -> PublicationOut:
    """Make a version the one that new sessions on the level use; an older one rolls back.

    Sessions that are open stay on theirs. Publishing what is current changes nothing.
    """
    return PublicationOut.of(services.versions.publish(level_id, body.map_id, key_id=key.id, note=body.note))


@router.get(
    "/v1/levels/{level_id}/publications",
    summary="List what was published on a level",
    dependencies=[needs(Scope.SURVEY)],
    responses=guarded(errors.NOT_FOUND, errors.INVALID),
)
def list_publications(
    level_id: str, services: ServicesDep, paging: PagingDep, request: Request, response: Response
) -> PublicationPage:
    """Which version was published when, by whom and in place of which, newest first."""
    page = services.versions.publications(level_id, paging.cursor, paging.limit)
    link_next(request, response, page.next_cursor)
    return PublicationPage(items=[PublicationOut.of(one) for one in page.items], next_cursor=page.next_cursor)


@router.get(
    "/v1/maps/{map_id}/sources",
    summary="List who contributed to a map",
    dependencies=[needs(Scope.SURVEY)],
    responses=guarded(errors.NOT_FOUND, errors.INVALID),
)
def list_sources(
    map_id: str, services: ServicesDep, paging: PagingDep, request: Request, response: Response
) -> MapSourcePage:
    """Survey walks that a version rests on, and those that were left out, with the reason."""
    page = services.versions.sources(map_id, paging.cursor, paging.limit)
    link_next(request, response, page.next_cursor)
    return MapSourcePage(items=[MapSourceOut.of(one) for one in page.items], next_cursor=page.next_cursor)


@router.get(
    "/v1/maps/{map_id}/diff",
    summary="Compare a map with another version",
    dependencies=[any_key()],
    response_model=DiffOut,
    responses={
        200: raster_answer("The difference in numbers, or a raster with its place in `X-Isodyn-*` headers."),
        **NOT_MODIFIED,
        **guarded(errors.NOT_FOUND, errors.INVALID),
    },
)
def get_diff(
    map_id: str,
    request: Request,
    services: ServicesDep,
    against: Annotated[str | None, Query(description="Another version of the level; without it, the parent.")] = None,
    format: Annotated[DiffFormat, Query(description="`json`: numbers; `png` or `f32`: a raster.")] = DiffFormat.JSON,  # noqa: A002
    component: Annotated[
        Component, Query(description="Rasters: `all` is the length of the change, the others have a sign.")
    ] = Component.ALL,
    statistic: Annotated[
        DiffStatistic, Query(description="Rasters: `change` in uT; `significance`: over the combined sd.")
    ] = DiffStatistic.CHANGE,
    least_ut: Annotated[
        float, Query(ge=0, le=1e3, allow_inf_nan=False, description="Numbers: a node changed if by more than this.")
    ] = LEAST_UT,
    low: Annotated[
        float | None, Query(ge=-1e6, le=1e6, allow_inf_nan=False, description="PNG: value of the first colour.")
    ] = None,
    high: Annotated[
        float | None, Query(ge=-1e6, le=1e6, allow_inf_nan=False, description="PNG: value of the last colour.")
    ] = None,
) -> Response:
    """What a version changed, node by node, new minus old.

    `png`: one pixel a node of both extents together, north up, transparent where either version is not mapped; colours
    lie evenly about 0 for what has a sign. `f32`: little-endian float32, row by row from the lowest y, NaN there.
    """
    now, then = services.versions.compared(map_id, against)
    chosen = (component, statistic, f"{low}", f"{high}") if format is not DiffFormat.JSON else (f"{least_ut}",)
    # ids beside the hashes: what is told of settings and sources is not in the content
    entity_tag = tag(now.id, then.id, now.hash[:16], then.hash[:16], format, *chosen)
    unchanged = not_modified(request, entity_tag, IMMUTABLE)
    if unchanged is not None:
        return unchanged
    if format is DiffFormat.JSON:
        diff = DiffOut.of(services.versions.diff(map_id, then.id, least_ut=least_ut))
        return tagged(diff.model_dump_json().encode(), "application/json", entity_tag, IMMUTABLE)
    raster = services.versions.change(now, then, component, significance=statistic is DiffStatistic.SIGNIFICANCE)
    rows, columns = raster.values.shape
    place = rendering.place_headers((rows, columns), raster.x0, raster.y0, raster.cell_m)
    if format is DiffFormat.F32:
        return tagged(rendering.raw(raster.values), RAW, entity_tag, IMMUTABLE, place)
    shown = _colours(raster.values, component, statistic, low, high)
    image = rendering.png(raster.values, shown)
    return tagged(image, PNG, entity_tag, IMMUTABLE, {**place, **rendering.legend(shown)})


def _colours(
    values: Float32Array, component: Component, statistic: DiffStatistic, low: float | None, high: float | None
) -> ColourRange:
    """From 0 (or evenly about it) to the largest 1 %, but not so fine that what means nothing shines."""
    least = SIGNIFICANT if statistic is DiffStatistic.SIGNIFICANCE else LEAST_UT
    finite = np.abs(values[np.isfinite(values)])
    top = max(least, float(np.percentile(finite, 99))) if finite.size else least
    bottom = 0.0 if component is Component.ALL else -top
    return rendering.colour_range(values, bottom if low is None else low, top if high is None else high)
