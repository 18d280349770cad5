"""One-shot location."""

from __future__ import annotations

from functools import partial

import anyio
import orjson
from fastapi import Request, Response

from app.api import errors
from app.api.auth import needs
from app.api.body import UPLOAD_TYPES, media_type, read_body, require_media_type
from app.api.deps import ContextDep
from app.api.plausibility import SEGMENT_LIMITS
from app.api.responses import OBJECT, guarded, upload
from app.api.routing import api_router
from app.api.schemas.locate import LOCATE_EXAMPLE, LocateIn, LocateOut, located_object
from app.api.uploads import checked_samples, parse
from app.services.container import Services
from app.services.records import Scope

router = api_router("locate")


@router.post(
    "/v1/locate",
    summary="Locate samples at once",
    dependencies=[needs(Scope.LOCATE)],
    response_model=LocateOut,
    responses=guarded(*OBJECT, errors.NOT_FOUND, errors.NO_MAP, errors.WORKER_LOST),
    openapi_extra=upload(LocateIn, LOCATE_EXAMPLE),
)
async def locate(request: Request, context: ContextDep) -> Response:
    """Send samples, get their trajectory: no session, nothing stored. At most 60 s or 20,000 samples."""
    require_media_type(request, *UPLOAD_TYPES)
    body = await read_body(request, context.settings.max_body_bytes)
    work = partial(_locate, context.services, body, media_type(request))
    return Response(await anyio.to_thread.run_sync(work, limiter=context.locates), media_type="application/json")


def _locate(services: Services, body: bytes, kind: str) -> bytes:
    query = parse(body, kind, LocateIn)
    samples, wifi = checked_samples(query.samples, query.wifi, query.frame, SEGMENT_LIMITS)
    located = services.locate.locate(
        query.level_id,
        query.method,
        query.parameters,
        query.prior.prior(query.level_id) if query.prior else None,
        samples,
        wifi=wifi,
        map_id=query.map_id,
    )
    return orjson.dumps(located_object(located))
