"""A session over one WebSocket: segments up, positions down, both numbered, so that a cut loses and repeats nothing."""

from __future__ import annotations

import asyncio
import contextlib
from dataclasses import dataclass, field
from typing import Any

import orjson
import structlog
from fastapi import WebSocket, WebSocketDisconnect
from starlette.concurrency import run_in_threadpool

from app.api.auth import authenticate, has_scope, secret_of
from app.api.body import JSON, MSGPACK, decode_json
from app.api.deps import Context
from app.api.errors import (
    INTERNAL,
    BodyTooLargeError,
    RateLimitedError,
    UnauthorizedError,
    problem_of,
)
from app.api.ports import Watch
from app.api.schemas.samples import SegmentIn
from app.api.streams import PING_S, STALLED_S, fixes_object, open_watch, session_object
from app.api.uploads import new_segment, parse
from app.services.errors import ForbiddenError, InvalidError
from app.services.records import Accepted, ApiKey, Scope

AUTH_S = 10.0
"""How long a client may take to send its key, if the handshake had none."""
OVER, RESTART = 1000, 1012
_GONE = 1006
REFUSED = 4000
"""Plus the HTTP status: why the service ended the connection."""
_MAX_CONTROL = 4096

_log = structlog.stdlib.get_logger(__name__)


@dataclass
class Duplex:
    """One connection. ``run`` returns when the session is over, the client gone, or the service stops."""

    context: Context
    socket: WebSocket
    session_id: str
    after: int
    _sending: asyncio.Lock = field(default_factory=asyncio.Lock)

    async def run(self) -> None:
        """Serve the connection."""
        await self.socket.accept()
        try:
            secret = await self._secret()
            watch = open_watch(self.context, self.session_id)
        except (WebSocketDisconnect, TimeoutError):
            return
        except Exception as error:  # noqa: BLE001 - as for a request: every error becomes a problem for the client
            await self._refuse(error)
            return
        try:
            await self._serve(secret, watch)
        finally:
            watch.cancel()

    async def _serve(self, secret: str, watch: Watch) -> None:
        try:
            session = await run_in_threadpool(self.context.services.sessions.get, self.session_id)
        except Exception as error:  # noqa: BLE001 - as above
            await self._refuse(error)
            return
        await self._send("ready", session_id=session.id, next_seq=session.next_seq, after=self.after)
        down = asyncio.create_task(self._down(secret, watch))
        up = asyncio.create_task(self._up(secret))
        done, pending = await asyncio.wait({down, up}, return_when=asyncio.FIRST_COMPLETED)
        for task in pending:
            task.cancel()
        await asyncio.gather(*pending, return_exceptions=True)
        with contextlib.suppress(WebSocketDisconnect):
            for task in done:
                await self._end(task)

    async def _end(self, task: asyncio.Task[None]) -> None:
        try:
            task.result()
        except UnauthorizedError as error:
            await self._refuse(error)

    async def _secret(self) -> str:
        """The secret of a key that may come in."""
        headers = self.socket.headers
        if "authorization" in headers or "x-api-key" in headers:
            secret = secret_of(self.socket)
        else:
            secret = _first_key(await asyncio.wait_for(self._first_text(), AUTH_S))
        key = await authenticate(self.context.keys, secret)
        if not has_scope(key, Scope.LOCATE):
            raise ForbiddenError(Scope.LOCATE.value)
        self._count(key)
        return secret

    async def _first_text(self) -> str | None:
        message = await self.socket.receive()
        if message["type"] == "websocket.disconnect":
            raise WebSocketDisconnect(message["code"])
        text: str | None = message.get("text")
        return text

    async def _down(self, secret: str, watch: Watch) -> None:
        """Tell every position above ``after`` once, in order, for as long as the key is good."""
        while not watch.closed:
            await authenticate(self.context.keys, secret)
            news = await run_in_threadpool(self.context.services.live.news, self.session_id, self.after)
            if news.positions:
                await self._send("fixes", **fixes_object(news))
                self.after = news.positions[-1].number
            if news.over:
                await self._send("session", session=session_object(news))
                await self.socket.close(OVER, "the session is over")
                return
            if news.complete:
                await watch.wait(PING_S)
        await self.socket.close(RESTART, "the service restarts; connect again")

    async def _up(self, secret: str) -> None:
        """Take segments, one after the other: who sends faster than they are stored is held back by the socket."""
        while True:
            message = await self.socket.receive()
            if message["type"] == "websocket.disconnect":
                return
            key = await authenticate(self.context.keys, secret)
            try:
                self._count(key)
                await self._take(message.get("bytes"), message.get("text"))
            except WebSocketDisconnect:
                raise
            except Exception as error:  # noqa: BLE001 - as for a request: every error becomes a problem for the client
                await self._problem(error)

    async def _take(self, data: bytes | None, text: str | None) -> None:
        if text is not None and len(text) <= _MAX_CONTROL and await self._control(text):
            return
        body, kind = (data, MSGPACK) if data is not None else ((text or "").encode(), JSON)
        accepted = await run_in_threadpool(self._accept, body, kind)
        await self._send("accepted", seq=accepted.segment.seq, repeated=accepted.repeated)

    async def _control(self, text: str) -> bool:
        """Do what a short text asks for; False if it is a segment."""
        value = decode_json(text.encode())
        if isinstance(value, dict) and "type" not in value:
            return False
        if not isinstance(value, dict) or value.get("type") != "close":
            raise InvalidError("type", "is not known here", 'send a segment, or {"type": "close"}')
        await run_in_threadpool(self.context.services.sessions.close, self.session_id)
        return True

    def _accept(self, body: bytes, kind: str) -> Accepted:
        most = self.context.settings.max_body_bytes
        if len(body) > most:
            raise BodyTooLargeError(f"the message has {len(body)} bytes; at most {most} are taken: send smaller pieces")
        segment = new_segment(parse(body, kind, SegmentIn), self.context.clock())
        return self.context.services.sessions.accept(self.session_id, segment)

    def _count(self, key: ApiKey) -> None:
        quota = self.context.limiter.take(key.id)
        if quota is not None and not quota.allowed:
            raise RateLimitedError(quota.retry_after_s)

    async def _refuse(self, error: Exception) -> None:
        await self._problem(error)
        await self.socket.close(REFUSED + problem_of(error).type.status, "refused")

    async def _problem(self, error: Exception) -> None:
        problem = problem_of(error)
        if problem.type is INTERNAL:
            _log.error("unexpected error in a stream", session=self.session_id, exc_info=error)
        retry = problem.headers.get("Retry-After")
        more = {} if retry is None else {"retry_after_s": int(retry)}
        await self._send("problem", problem=problem.document(self.socket.url.path), **more)

    async def _send(self, kind: str, **values: Any) -> None:
        async with self._sending:
            try:
                async with asyncio.timeout(STALLED_S):
                    await self.socket.send_text(orjson.dumps({"type": kind, **values}).decode())
            except TimeoutError:
                raise WebSocketDisconnect(_GONE, "takes nothing any more") from None


def _first_key(text: str | None) -> str:
    value = None if text is None else decode_json(text[:_MAX_CONTROL].encode())
    secret = value.get("key") if isinstance(value, dict) and value.get("type") == "auth" else None
    if not isinstance(secret, str) or not secret:
        raise UnauthorizedError('send a key in the handshake\'s headers, or {"type": "auth", "key": ...} first')
    return secret
