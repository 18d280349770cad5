"""Tracks of sessions as files."""

from __future__ import annotations

from functools import partial
from typing import Annotated, Any

import anyio
from fastapi import Query, Response
from fastapi.responses import StreamingResponse

from app.api import errors
from app.api.auth import needs
from app.api.deps import ContextDep
from app.api.errors import NoAnchorError
from app.api.responses import guarded
from app.api.routing import api_router
from app.api.schemas.tracks import TRACK_EXAMPLE
from app.engine.types import FixKind
from app.exchange.tracks import FORMATS, TrackFormat
from app.services.container import Services
from app.services.records import Scope
from app.services.tracks import TrackExport

router = api_router("positions")

_WORDS = "; ".join(f"`{kind.value}`: {form.words}" for kind, form in FORMATS.items())
_KIND = "As told in the moment, about 5 s later, or (computed with this call) from the whole session."


def _content(media_type: str) -> dict[str, Any]:
    if media_type.endswith("json"):
        return {"schema": {"type": "object"}, "example": TRACK_EXAMPLE}
    return {"schema": {"type": "string"}}


@router.get(
    "/v1/sessions/{session_id}/track",
    summary="Read the track of a session as a file",
    dependencies=[needs(Scope.LOCATE)],
    response_class=Response,
    responses={
        200: {
            "description": "The file.",
            "content": {kind: _content(kind) for kind in sorted({form.media_type for form in FORMATS.values()})},
            "headers": {"Content-Disposition": {"schema": {"type": "string"}, "description": "Holds the file's name."}},
        },
        **guarded(errors.NOT_FOUND, errors.NO_ANCHOR, errors.CONFLICT, errors.INVALID, errors.WORKER_LOST),
    },
)
async def get_track(
    session_id: str,
    context: ContextDep,
    format: Annotated[TrackFormat, Query(description=f"{_WORDS}.")] = TrackFormat.GEOJSON,  # noqa: A002
    kind: Annotated[FixKind, Query(description=_KIND)] = FixKind.FILTERED,
) -> Response:
    """All fixes of a kind in one file, sent while it is read.

    Lines run through fixes that claim a position (`ok`) only, and break where `sure` changes, the level changes, a fix
    claims none, or nothing was told for 10 s. All formats but CSV are in WGS 84: the venue needs an anchor for them.
    """
    work = partial(_export, context.services, session_id, format, kind)
    limiter = context.smoothings if kind is FixKind.SMOOTHED else None
    export = await anyio.to_thread.run_sync(work, limiter=limiter)
    return StreamingResponse(
        export.pieces,
        media_type=export.media_type,
        headers={"Content-Disposition": f'attachment; filename="{export.file_name}"'},
    )


def _export(services: Services, session_id: str, form: TrackFormat, kind: FixKind) -> TrackExport:
    document = services.tracks.document(session_id, kind)
    if FORMATS[form].needs_anchor and document.plane is None:
        venue_id = services.sessions.get(session_id).venue_id
        raise NoAnchorError(f"venue {venue_id} has no anchor; PATCH /v1/venues/{venue_id} with one, or ask for csv")
    return services.tracks.export(document, form)
