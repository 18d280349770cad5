"""Survey planning: quality of maps, where to walk next, forecasts of routes."""

from __future__ import annotations

from typing import Annotated

import orjson
from fastapi import Query, Request, Response

from app.api import errors, rendering
from app.api.auth import any_key
from app.api.deps import ServicesDep
from app.api.errors import NoAnchorError
from app.api.etag import REVALIDATE, content_tag, not_modified, tagged
from app.api.geojson import GEO_JSON, wants_geo_json
from app.api.responses import NOT_MODIFIED, OBJECT, PNG, RAW, guarded, raster_answer, schema_of
from app.api.routers.maps import FieldFormat
from app.api.routing import api_router
from app.api.schemas.planning import (
    LAYER_WORDS,
    SUGGESTIONS_GEO_JSON,
    ForecastIn,
    ForecastOut,
    QualityOut,
    SuggestionCollection,
    SuggestionsOut,
    forecast_object,
    suggestions_geo_json,
    suggestions_object,
)
from app.services.planning import QualityLayer, QualityRaster

router = api_router("maps")

JSON = "application/json"
_LAYER = "; ".join(f"`{layer.value}`: {words}" for layer, words in LAYER_WORDS.items()) + "."


@router.get(
    "/v1/maps/{map_id}/quality",
    summary="Read how good a map is",
    dependencies=[any_key()],
    response_model=QualityOut,
    responses={**NOT_MODIFIED, **guarded(errors.NOT_FOUND, errors.CONFLICT)},
)
def get_quality(map_id: str, request: Request, services: ServicesDep) -> Response:
    """Coverage of the walkable space, expected accuracy, and where survey walks disagree.

    The expected error is a Cramer-Rao bound for a walker with a phone who came straight to a place, in eight
    directions: what no method beats on average, and a good one comes near to. A wrong place altogether is not in it.
    """
    content = QualityOut.of(services.planning.quality(map_id)).model_dump_json().encode()
    return not_modified(request, content_tag(content), REVALIDATE) or tagged(
        content, JSON, content_tag(content), REVALIDATE
    )


@router.get(
    "/v1/maps/{map_id}/quality/raster",
    summary="Read a raster of a map's quality",
    dependencies=[any_key()],
    response_class=Response,
    responses={
        200: raster_answer("The raster, with its place in `X-Isodyn-*` headers as those of `field`."),
        **NOT_MODIFIED,
        **guarded(errors.NOT_FOUND, errors.CONFLICT, errors.INVALID),
    },
)
def get_quality_raster(
    map_id: str,
    request: Request,
    services: ServicesDep,
    layer: Annotated[QualityLayer, Query(description=_LAYER)] = QualityLayer.MEAN_ERROR,
    heading_deg: Annotated[
        int | None,
        Query(description="Direction of travel, counter-clockwise from +x: 0, 45, ... 315. For `error` and the like."),
    ] = None,
    format: Annotated[FieldFormat, Query(description="`png`, or `f32`: raw.")] = FieldFormat.PNG,  # noqa: A002
    low: Annotated[
        float | None, Query(ge=-1e6, le=1e6, allow_inf_nan=False, description="PNG: value of the first colour.")
    ] = None,
    high: Annotated[
        float | None, Query(ge=-1e6, le=1e6, allow_inf_nan=False, description="PNG: value of the last colour.")
    ] = None,
) -> Response:
    """One layer, on the part of the map's grid that holds mapped ground (coarser on very large maps).

    `png`: one pixel a node, north up, transparent where there is nothing to say. `f32`: little-endian float32, row by
    row from the lowest y, NaN there.
    """
    raster = services.planning.raster(map_id, layer, heading_deg)
    place = _place(raster)
    if format is FieldFormat.F32:
        content, media_type = rendering.raw(raster.values), RAW
    else:
        shown = rendering.colour_range(raster.values, low, high)
        place |= {"X-Isodyn-Low": f"{shown.low:.6g}", "X-Isodyn-High": f"{shown.high:.6g}"}
        content, media_type = rendering.png(raster.values, shown), PNG
    entity_tag = content_tag(content)
    return not_modified(request, entity_tag, REVALIDATE) or tagged(content, media_type, entity_tag, REVALIDATE, place)


@router.get(
    "/v1/maps/{map_id}/suggestions",
    summary="Read where to survey next",
    dependencies=[any_key()],
    response_model=SuggestionsOut,
    responses={
        200: {
            "description": "Lines in level metres, or GeoJSON with `Accept: application/geo+json`.",
            "content": {GEO_JSON: {"schema": schema_of(SuggestionCollection), "example": SUGGESTIONS_GEO_JSON}},
        },
        **guarded(errors.NOT_FOUND, errors.NO_ANCHOR, errors.INVALID),
    },
)
def get_suggestions(
    map_id: str,
    request: Request,
    services: ServicesDep,
    count: Annotated[int, Query(ge=1, le=50, description="Lines at most.")] = 10,
) -> Response:
    """Straight lines whose survey would teach the map most per metre, best first, with reasons.

    With `Accept: application/geo+json` they are lines in WGS 84; the venue needs an anchor for that.
    """
    plan = services.planning.suggestions(map_id, count)
    headers = {"Vary": "Accept"}
    if not wants_geo_json(request):
        return Response(orjson.dumps(suggestions_object(plan)), media_type=JSON, headers=headers)
    if plan.anchor is None:
        raise NoAnchorError(
            f"venue {plan.venue_id} has no anchor; PATCH /v1/venues/{plan.venue_id} with one, or ask for JSON"
        )
    return Response(orjson.dumps(suggestions_geo_json(plan, plan.anchor)), media_type=GEO_JSON, headers=headers)


@router.post(
    "/v1/maps/{map_id}/forecast",
    summary="Forecast the accuracy along a route",
    dependencies=[any_key()],
    response_model=ForecastOut,
    responses=guarded(*OBJECT, errors.NOT_FOUND, errors.CONFLICT),
)
def forecast_route(map_id: str, body: ForecastIn, services: ServicesDep) -> Response:
    """Expected error along and across the way, and stretches where the position will be lost or doubtful."""
    outlook = services.planning.forecast(map_id, body.corners(), body.known_m)
    return Response(orjson.dumps(forecast_object(map_id, outlook)), media_type=JSON)


def _place(raster: QualityRaster) -> dict[str, str]:
    rows, columns = raster.values.shape
    return {
        "X-Isodyn-Rows": str(rows),
        "X-Isodyn-Columns": str(columns),
        "X-Isodyn-X0": repr(float(raster.x0)),
        "X-Isodyn-Y0": repr(float(raster.y0)),
        "X-Isodyn-Cell-M": repr(float(raster.cell_m)),
    }
