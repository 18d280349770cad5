"""Streams of server-sent events: positions of one session, and of all that run."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Sequence
from typing import Any

import orjson
from fastapi import Response
from fastapi.responses import StreamingResponse
from fastapi.sse import KEEPALIVE_COMMENT, format_sse_event
from starlette.concurrency import run_in_threadpool
from starlette.types import Message, Send

from app.api.auth import is_known
from app.api.deps import Context
from app.api.ports import Watch
from app.api.schemas.fixes import heading_deg, t_ms
from app.api.schemas.positions import position_page
from app.api.schemas.sessions import SessionOut
from app.engine.types import FixKind
from app.services.errors import OverloadedError
from app.services.live import MAX_LIVE, News
from app.services.records import LastKnown, SessionStatus

EVENT_STREAM = "text/event-stream"
PING_S = 15.0
"""Silence after which a comment is sent, so that nobody between takes the connection for dead."""
STALLED_S = 60.0
"""A reader that takes nothing for so long is let go."""
GATHER_S = 0.05
"""Changes of many sessions are gathered so long: one query and one write for all of them."""
RETRY_AFTER_S = 5.0
MAX_NUMBER = 10**15
"""Larger numbers are of no fix."""
_MAX_TOLD = 10 * MAX_LIVE
"""A watcher that stays for weeks must not remember every session of that time."""

Events = AsyncIterator[bytes]


def open_watch(context: Context, session_id: str | None = None) -> Watch:
    """Begin to watch, if there is room for one more."""
    if context.hub.watching >= context.settings.max_streams:
        raise OverloadedError(RETRY_AFTER_S)
    return context.hub.watch(session_id)


def answer(events: Events) -> Response:
    """A stream that nobody between caches, gathers or changes."""
    headers = {"Cache-Control": "no-store, no-transform", "X-Accel-Buffering": "no"}
    return EventResponse(events, media_type=EVENT_STREAM, headers=headers)


class EventResponse(StreamingResponse):
    """A stream that ends when its reader stalls: one that never reads would keep its place among the streams."""

    async def stream_response(self, send: Send) -> None:
        """Send events while they are taken."""

        async def sent(message: Message) -> None:
            async with asyncio.timeout(STALLED_S):
                await send(message)

        with contextlib.suppress(TimeoutError):
            async with contextlib.aclosing(self.body_iterator):  # type: ignore[type-var]
                await super().stream_response(sent)


async def session_events(
    context: Context, watch: Watch, secret: str, session_id: str, after: int, kind: FixKind
) -> Events:
    """Positions numbered above ``after``, then each new one as it is told, until the session is over."""
    try:
        while not watch.closed and await is_known(context.keys, secret):
            news = await run_in_threadpool(context.services.live.news, session_id, after, kind)
            if news.positions:
                after = news.positions[-1].number
                yield event("fixes", fixes_object(news), after)
            if news.over:
                yield event("session", session_object(news))
                return
            if news.complete and not await watch.wait(PING_S) and not watch.closed:
                yield KEEPALIVE_COMMENT
    finally:
        watch.cancel()


async def live_events(
    context: Context, watch: Watch, secret: str, first: Sequence[LastKnown], *places: str | None
) -> Events:
    """Where sessions are: all of a place at first, then each one that changed."""
    told = {known.session.id: _number(known) for known in first}
    try:
        yield event("snapshot", {"sessions": [last_known_object(known) for known in first]})
        while not watch.closed:
            changed = sorted(await watch.wait(PING_S))
            if not await is_known(context.keys, secret):
                return
            for start in range(0, len(changed), MAX_LIVE):
                some = changed[start : start + MAX_LIVE]
                rows = await run_in_threadpool(context.services.live.last_known, some, *places)
                for known in reversed(rows):
                    for message in _changes(known, told):
                        yield message
            if changed:
                await asyncio.sleep(GATHER_S)
            elif not watch.closed:
                yield KEEPALIVE_COMMENT
    finally:
        watch.cancel()


def _changes(known: LastKnown, told: dict[str, int]) -> list[bytes]:
    """What is new of a session to somebody who was told these numbers."""
    session = known.session
    is_open = session.status is SessionStatus.OPEN
    messages = []
    if session.id not in told and is_open:
        messages.append(event("session", {"id": session.id, "status": session.status.value}))
    if _number(known) > told.get(session.id, -1):
        messages.append(event("fix", last_known_object(known)))
    told[session.id] = _number(known)
    if not is_open:
        # its last segments may come in still, after which it is told of once more
        messages.append(event("session", {"id": session.id, "status": session.status.value}))
    if len(told) > _MAX_TOLD:
        told.pop(next(iter(told)))
    return messages


def _number(known: LastKnown) -> int:
    return -1 if known.position is None else known.position.number


def event(name: str, data: Any, number: int | None = None) -> bytes:
    """One event; ``number`` is what a client sends as Last-Event-ID when it comes back."""
    text = orjson.dumps(data).decode()
    return format_sse_event(event=name, data_str=text, id=None if number is None else str(number))


def fixes_object(news: News) -> dict[str, Any]:
    """Positions as plain values: a page of ``GET positions`` without a cursor."""
    page = position_page(news.positions, None)
    del page["next_cursor"]
    return page


def session_object(news: News) -> dict[str, Any]:
    """The session as ``GET /v1/sessions/{id}`` shows it."""
    return SessionOut.of(news.session).model_dump(mode="json")


def last_known_object(known: LastKnown) -> dict[str, Any]:
    """A session and its last position as plain values, the shape of LastKnownOut."""
    session, position = known.session, known.position
    place: dict[str, Any] = dict.fromkeys(_PLACE)
    if position is not None:
        fix = position.fix
        values = (t_ms(fix), round(fix.x, 3), round(fix.y, 3), fix.cov_xx, fix.cov_xy, fix.cov_yy, heading_deg(fix))
        place = dict(zip(_PLACE, (*values, fix.status.value, fix.sure, position.number), strict=True))
    return {
        "session_id": session.id,
        "device_id": session.device_id,
        "venue_id": session.venue_id,
        "level_id": session.level_id if position is None else position.fix.level_id,
        **place,
    }


_PLACE = ("t_ms", "x", "y", "cov_xx", "cov_xy", "cov_yy", "heading_deg", "status", "sure", "number")
