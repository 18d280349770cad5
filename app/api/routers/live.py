"""Sessions as they go: server-sent events for watchers."""

from __future__ import annotations

import re
from typing import Annotated, Any, Literal

from fastapi import Header, Query, Request, Response
from starlette.concurrency import run_in_threadpool

from app.api import errors
from app.api.auth import needs, secret_of
from app.api.deps import ContextDep
from app.api.responses import guarded
from app.api.routing import api_router
from app.api.streams import EVENT_STREAM, MAX_NUMBER, answer, live_events, open_watch, session_events
from app.engine.types import FixKind
from app.services.errors import InvalidError
from app.services.records import Scope

router = api_router("live")

_NUMBER = re.compile(r"-1|[0-9]{1,16}")


def _stream(description: str) -> dict[str, Any]:
    return {"description": description, "content": {EVENT_STREAM: {"schema": {"type": "string"}}}}


@router.get(
    "/v1/sessions/{session_id}/events",
    summary="Follow a session",
    dependencies=[needs(Scope.LOCATE)],
    response_class=Response,
    responses={
        200: _stream("Events `fixes` (their `id` is the number of the last fix) and, at the end, `session`."),
        **guarded(errors.NOT_FOUND, errors.INVALID, errors.OVERLOADED),
    },
)
async def follow_session(
    session_id: str,
    request: Request,
    context: ContextDep,
    after: Annotated[
        int | None, Query(ge=-1, le=MAX_NUMBER, description="Number of the last fix you have; -1: from the start.")
    ] = None,
    kind: Annotated[
        Literal[FixKind.FILTERED, FixKind.FIXED_LAG], Query(description="As of `GET .../positions`.")
    ] = FixKind.FILTERED,
    last_event_id: Annotated[
        str | None, Header(description="As browsers send it when they come back; wins over `after`.")
    ] = None,
) -> Response:
    """Server-sent events: every fix of the session once, in order, first those of before.

    A client that was cut off sends the last `id` it saw and misses nothing. The stream ends with the session as
    `session`, when it is closed and its last segment processed. Comments keep the connection alive.
    """
    number = _number(last_event_id) if last_event_id is not None else after
    watch = open_watch(context, session_id)
    try:
        await run_in_threadpool(context.services.sessions.get, session_id)
    except Exception:
        watch.cancel()
        raise
    return answer(
        session_events(context, watch, secret_of(request), session_id, -1 if number is None else number, kind)
    )


@router.get(
    "/v1/live",
    summary="Follow all sessions",
    dependencies=[needs(Scope.LOCATE)],
    response_class=Response,
    responses={
        200: _stream("Event `snapshot` first, then `fix` and `session` as they come."),
        **guarded(errors.NOT_FOUND, errors.INVALID, errors.OVERLOADED),
    },
)
async def follow_all(
    request: Request,
    context: ContextDep,
    venue_id: Annotated[str | None, Query(description="In this venue only.")] = None,
    level_id: Annotated[str | None, Query(description="On this level only.")] = None,
) -> Response:
    """Server-sent events: where each open session is, as a `snapshot`, and each change after it.

    A `fix` is the last position told with a segment; between two events of a session there may have been more, which
    `GET /v1/sessions/{session_id}/events` tells without gaps. At most 1000 sessions come with the snapshot.
    """
    watch = open_watch(context)
    try:
        first = await run_in_threadpool(context.services.live.snapshot, venue_id, level_id)
    except Exception:
        watch.cancel()
        raise
    return answer(live_events(context, watch, secret_of(request), first, venue_id, level_id))


def _number(text: str) -> int:
    if _NUMBER.fullmatch(text):
        return int(text)
    raise InvalidError("Last-Event-ID", f"{text[:50]!r} is no number of a fix", "send the id of the last event")
