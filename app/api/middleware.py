"""What every answer gets: rate limit headers, and a place in the metrics. HEAD is GET without the body."""

from __future__ import annotations

import time

from starlette.datastructures import MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from app.api.ports import Metrics
from app.api.ratelimit import Quota

UNMATCHED = "unmatched"


class AnswerMiddleware:
    """Plain ASGI, so that bodies stream through untouched."""

    def __init__(self, app: ASGIApp, *, metrics: Metrics, policy: str) -> None:
        self._app = app
        self._metrics = metrics
        self._policy = policy

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on and look at its answer."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        started = time.perf_counter()
        head = scope["method"] == "HEAD"
        inner = {**scope, "method": "GET", "state": scope.setdefault("state", {})} if head else scope
        # What no handler answers, the server answers with 500.
        status = 500

        async def answer(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
                self._add_headers(inner, MutableHeaders(scope=message))
            elif head:
                message = {**message, "body": b""}
            await send(message)

        try:
            await self._app(inner, receive, answer)
        finally:
            seconds = time.perf_counter() - started
            self._metrics.observe_request(scope["method"], _route_of(inner), status, seconds)

    def _add_headers(self, scope: Scope, headers: MutableHeaders) -> None:
        headers["X-Content-Type-Options"] = "nosniff"
        quota = scope.get("state", {}).get("quota")
        if isinstance(quota, Quota):
            headers["RateLimit-Policy"] = self._policy
            headers["RateLimit"] = f'"key";r={quota.remaining};t={quota.reset_s}'


def _route_of(scope: Scope) -> str:
    path = getattr(scope.get("route"), "path", None)
    return path if isinstance(path, str) else UNMATCHED
