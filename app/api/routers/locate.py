"""One-shot location."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from functools import partial

import anyio
import orjson
from fastapi import Request, Response

from app.api import errors
from app.api.aids import checked_aids
from app.api.auth import needs
from app.api.body import SEGMENT_BYTES, UPLOAD_TYPES, media_type, read_body, require_media_type
from app.api.deps import ContextDep
from app.api.plausibility import SEGMENT_LIMITS
from app.api.responses import OBJECT, guarded, upload
from app.api.routing import api_router
from app.api.schemas.locate import LOCATE_EXAMPLE, LocateIn, LocateOut, located_object
from app.api.uploads import LARGE_BYTES, checked_samples, parse
from app.engine.types import ImuSamples
from app.services.aids import Aids
from app.services.container import Services
from app.services.records import Scope

router = api_router("locate")


@dataclass(frozen=True, slots=True)
class _Query:
    """A request whose samples are checked."""

    request: LocateIn
    samples: ImuSamples
    aids: Aids


@router.post(
    "/v1/locate",
    summary="Locate samples at once",
    dependencies=[needs(Scope.LOCATE)],
    response_model=LocateOut,
    responses=guarded(*OBJECT, errors.NOT_FOUND, errors.NO_MAP, errors.WORKER_LOST),
    openapi_extra=upload(LocateIn, LOCATE_EXAMPLE),
)
async def locate(request: Request, context: ContextDep) -> Response:
    """Send samples, get their trajectory: no session, nothing stored. At most 60 s or 20,000 samples.

    Exactly one of `level_id` and `venue_id`; with a venue the level is found among those that have a map.
    """
    require_media_type(request, *UPLOAD_TYPES)
    body = await read_body(request, context.settings.max_body_bytes, inflated=SEGMENT_BYTES)
    # Decoded under the limit of uploads, not of locations: sixteen large bodies at once would be gigabytes.
    limiter = context.uploads if len(body) > LARGE_BYTES else None
    query = await anyio.to_thread.run_sync(_read, body, media_type(request), context.clock(), limiter=limiter)
    del body
    work = partial(_locate, context.services, query)
    return Response(await anyio.to_thread.run_sync(work, limiter=context.locates), media_type="application/json")


def _read(body: bytes, kind: str, now: datetime) -> _Query:
    request = parse(body, kind, LocateIn)
    samples = checked_samples(request.samples, request.frame, SEGMENT_LIMITS, now)
    return _Query(request, samples, checked_aids(request, request.samples.t_ms))


def _locate(services: Services, query: _Query) -> bytes:
    request = query.request
    located = services.locate.locate(
        request.level_id,
        request.method,
        request.parameters,
        request.prior.prior() if request.prior else None,
        query.samples,
        venue_id=request.venue_id,
        aids=query.aids,
        map_id=request.map_id,
    )
    return orjson.dumps(located_object(located))
