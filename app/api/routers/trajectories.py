"""Smoothed trajectories of sessions."""

from __future__ import annotations

from functools import partial

import anyio
import orjson
from fastapi import Response

from app.api import errors
from app.api.auth import needs
from app.api.deps import ContextDep
from app.api.responses import guarded
from app.api.routing import api_router
from app.api.schemas.trajectories import TrajectoryOut, trajectory_object
from app.services.container import Services
from app.services.records import Scope

router = api_router("positions")


@router.get(
    "/v1/sessions/{session_id}/trajectory",
    summary="Read the smoothed trajectory of a session",
    dependencies=[needs(Scope.LOCATE)],
    response_model=TrajectoryOut,
    responses=guarded(errors.NOT_FOUND, errors.CONFLICT, errors.WORKER_LOST),
)
async def get_trajectory(session_id: str, context: ContextDep) -> Response:
    """The whole trip after the fact, one fix per step: each uses the samples before *and* after its time.

    From all segments processed so far, computed anew with each call. Of sessions with the method `particle`, up to
    360 segments and 30 minutes of samples.
    """
    work = partial(_smooth, context.services, session_id)
    return Response(await anyio.to_thread.run_sync(work, limiter=context.smoothings), media_type="application/json")


def _smooth(services: Services, session_id: str) -> bytes:
    return orjson.dumps(trajectory_object(services.trajectories.trajectory(session_id)))
