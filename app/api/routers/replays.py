"""Replays of sessions on other map versions."""

from __future__ import annotations

from functools import partial

import anyio
import orjson
from fastapi import Response

from app.api import errors
from app.api.auth import needs
from app.api.deps import ContextDep
from app.api.responses import OBJECT, guarded
from app.api.routing import api_router
from app.api.schemas.replays import ReplayIn, ReplayOut, replay_object
from app.services.container import Services
from app.services.records import Scope

router = api_router("positions")


@router.post(
    "/v1/sessions/{session_id}/replay",
    summary="Replay a session on other map versions",
    dependencies=[needs(Scope.LOCATE)],
    response_model=ReplayOut,
    responses=guarded(*OBJECT, errors.NOT_FOUND, errors.CONFLICT, errors.NO_MAP, errors.WORKER_LOST),
)
async def replay_session(session_id: str, body: ReplayIn, context: ContextDep) -> Response:
    """Take the stored segments of a session once more, on other map versions, and compare with what was told then.

    From the session's own prior, calibration and seed, so that on the maps of then the answer is that of then. Nothing
    is stored. Of sessions of up to 360 segments and 30 minutes of samples.
    """
    work = partial(_replay, context.services, session_id, body)
    return Response(await anyio.to_thread.run_sync(work, limiter=context.smoothings), media_type="application/json")


def _replay(services: Services, session_id: str, body: ReplayIn) -> bytes:
    return orjson.dumps(replay_object(services.replays.replay(session_id, body.map_id, body.map_ids)))
