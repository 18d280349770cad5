"""Segments: the uploads of a session and what came of them."""

from __future__ import annotations

from functools import partial

import anyio
import orjson
from fastapi import Request, Response
from starlette.concurrency import run_in_threadpool

from app.api import errors
from app.api.auth import needs
from app.api.body import SEGMENT_BYTES, UPLOAD_TYPES, media_type, read_body, require_media_type
from app.api.deps import PREFER_PARAMETER, Context, ContextDep, SeqPath, ServicesDep, WaitDep
from app.api.pagination import PagingDep, link_next
from app.api.responses import OBJECT, guarded, upload
from app.api.routing import api_router
from app.api.schemas.samples import SEGMENT_EXAMPLE, SegmentIn
from app.api.schemas.segments import SEGMENT_QUEUED, SegmentInfoOut, SegmentOut, SegmentPage, segment_object
from app.api.uploads import LARGE_BYTES, new_segment, parse
from app.services.container import Services
from app.services.records import Accepted, JobState, Scope

router = api_router("segments")

_FINAL = frozenset({JobState.DONE, JobState.FAILED, JobState.CANCELLED})


@router.post(
    "/v1/sessions/{session_id}/segments",
    status_code=202,
    summary="Send a segment",
    dependencies=[needs(Scope.LOCATE)],
    response_model=SegmentOut,
    responses={
        200: {
            "model": SegmentOut,
            "description": "The segment is processed: `Prefer: wait=N` was enough, or it had been sent before.",
        },
        202: {
            "description": "Stored; it will be processed once, whatever happens.",
            "content": {"application/json": {"example": SEGMENT_QUEUED}},
        },
        **guarded(
            *OBJECT,
            errors.NOT_FOUND,
            errors.SEQUENCE_CONFLICT,
            errors.SEQUENCE_GAP,
            errors.SESSION_CLOSED,
            errors.OVERLOADED,
        ),
    },
    openapi_extra={**upload(SegmentIn, SEGMENT_EXAMPLE), "parameters": [PREFER_PARAMETER]},
)
async def add_segment(session_id: str, request: Request, context: ContextDep, wait: WaitDep) -> Response:
    """Send the next stretch of samples; at most 60 s or 20,000 samples, 5 s is typical.

    Everything is checked before anything is stored. The same `seq` with the same samples gives the first answer again
    (with `Isodyn-Repeated: true`), so a call whose answer was lost may simply be repeated.
    """
    require_media_type(request, *UPLOAD_TYPES)
    body = await read_body(request, context.settings.max_body_bytes, inflated=SEGMENT_BYTES)
    accept = partial(_accept, context, session_id, body, media_type(request))
    limiter = context.uploads if len(body) > LARGE_BYTES else None
    accepted = await anyio.to_thread.run_sync(accept, limiter=limiter)
    final = accepted.job.state in _FINAL
    waited = not final and wait.seconds > 0
    if waited:
        final = await context.broker.wait(accepted.job.id, wait.seconds) is not None
    content = (
        await run_in_threadpool(read_segment, context.services, session_id, accepted.segment.seq)
        if final
        else orjson.dumps(segment_object(accepted.segment))
    )
    return Response(
        content,
        status_code=200 if final else 202,
        media_type="application/json",
        headers={
            "Location": f"/v1/sessions/{session_id}/segments/{accepted.segment.seq}",
            **({"Isodyn-Repeated": "true"} if accepted.repeated else {}),
            **(wait.applied if waited and final else {}),
        },
    )


@router.get(
    "/v1/sessions/{session_id}/segments",
    summary="List the segments of a session",
    dependencies=[needs(Scope.LOCATE)],
    responses=guarded(errors.NOT_FOUND, errors.INVALID),
)
def list_segments(
    session_id: str, services: ServicesDep, paging: PagingDep, request: Request, response: Response
) -> SegmentPage:
    """Segments without their fixes, oldest first; the cursor is the `seq` of the last one seen."""
    page = services.sessions.segments(session_id, paging.cursor, paging.limit)
    link_next(request, response, page.next_cursor)
    return SegmentPage(items=[SegmentInfoOut.of(info) for info in page.items], next_cursor=page.next_cursor)


@router.get(
    "/v1/sessions/{session_id}/segments/{seq}",
    summary="Read a segment",
    dependencies=[needs(Scope.LOCATE)],
    response_model=SegmentOut,
    responses=guarded(errors.NOT_FOUND, errors.INVALID),
)
def get_segment(session_id: str, seq: SeqPath, services: ServicesDep) -> Response:
    """Where a segment stands, and its fixes once it is processed."""
    return Response(read_segment(services, session_id, seq), media_type="application/json")


def read_segment(services: Services, session_id: str, seq: int) -> bytes:
    """Render a segment with its fixes, if it has any."""
    result = services.sessions.result(session_id, seq)
    return orjson.dumps(segment_object(result.segment, result.fixes, result.lagged))


def _accept(context: Context, session_id: str, body: bytes, kind: str) -> Accepted:
    segment = new_segment(parse(body, kind, SegmentIn), context.clock())
    return context.services.sessions.accept(session_id, segment)
