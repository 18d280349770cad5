"""What a session sent: raw samples, and the field along its track."""

from __future__ import annotations

from functools import partial
from typing import Annotated

import anyio
import orjson
from fastapi import Query, Response
from fastapi.responses import StreamingResponse

from app.api import errors
from app.api.auth import needs
from app.api.body import MSGPACK
from app.api.deps import ContextDep, ServicesDep
from app.api.responses import guarded
from app.api.routing import api_router
from app.api.schemas.samples import MAX_SEQ
from app.api.schemas.session_samples import ProfileOut, profile_object
from app.api.session_files import COLUMNS, CSV, SamplesFormat, write
from app.services.container import Services
from app.services.records import Scope

router = api_router("sessions")

_FORMAT = "`csv`: a line a sample. `msgpack`: an object a segment, one after the other, each as it can be sent again."


@router.get(
    "/v1/sessions/{session_id}/samples",
    summary="Read the raw samples of a session",
    dependencies=[needs(Scope.LOCATE)],
    response_class=Response,
    responses={
        200: {
            "description": "The file, sent while it is read.",
            "content": {
                CSV: {"schema": {"type": "string"}, "example": f"{','.join(COLUMNS)}\r\n"},
                MSGPACK: {"schema": {"type": "string", "contentMediaType": MSGPACK}},
            },
            "headers": {"Content-Disposition": {"schema": {"type": "string"}, "description": "Holds the file's name."}},
        },
        **guarded(errors.NOT_FOUND, errors.INVALID),
    },
)
def get_samples(
    session_id: str,
    services: ServicesDep,
    format: Annotated[SamplesFormat, Query(description=_FORMAT)] = SamplesFormat.CSV,  # noqa: A002
    after: Annotated[int, Query(ge=-1, le=MAX_SEQ, description="Only segments above this number.")] = -1,
    last: Annotated[int | None, Query(ge=0, le=MAX_SEQ, description="Only segments up to this number.")] = None,
) -> Response:
    """Magnetometer (uT), accelerometer (m/s^2, with gravity), gyroscope (rad/s) as stored: float32, axes of `android`.

    Aids are left out.
    """
    pieces = write(format, services.session_samples.segments(session_id, after, last))
    name = f"{session_id}-samples.{format.value}"
    return StreamingResponse(
        pieces, media_type=format.media_type, headers={"Content-Disposition": f'attachment; filename="{name}"'}
    )


@router.get(
    "/v1/sessions/{session_id}/profile",
    summary="Read the field along a session's track",
    dependencies=[needs(Scope.LOCATE)],
    response_model=ProfileOut,
    responses=guarded(errors.NOT_FOUND),
)
async def get_profile(session_id: str, context: ContextDep) -> Response:
    """What was measured at each position of the last half hour, beside what the session's map says there.

    Where the two differ by more than their `sd` over some metres, the position is wrong or the building has changed.
    """
    work = partial(_profile, context.services, session_id)
    return Response(await anyio.to_thread.run_sync(work, limiter=context.smoothings), media_type="application/json")


def _profile(services: Services, session_id: str) -> bytes:
    return orjson.dumps(profile_object(services.session_samples.profile(session_id)))
