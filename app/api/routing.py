"""The route class of the API: checks the key before the body, reads JSON bodies bounded and strictly."""

from __future__ import annotations

from collections.abc import Callable, Coroutine, Sequence
from typing import Any

from fastapi import APIRouter, Request, Response
from fastapi.routing import APIRoute

from app.api.auth import Access
from app.api.body import JSON, decode_json, read_body, require_media_type

MAX_OBJECT_BYTES = 64 * 1024
"""Largest body of a plain object (venue, session, ...); uploads have the limit of the settings."""

Handler = Callable[[Request], Coroutine[Any, Any, Response]]


class UndeclaredAccessError(TypeError):
    """A route does not say who may call it."""


class JsonRequest(Request):
    """A request whose body was read, inflated and decoded before."""

    def __init__(self, request: Request, body: bytes) -> None:
        super().__init__(request.scope, request.receive)
        self._body = body
        # Decoded here, not in json(): FastAPI turns whatever json() raises into a bare 400.
        self._value = decode_json(body) if body else None

    async def json(self) -> Any:
        """Return the decoded body."""
        return self._value


class ApiRoute(APIRoute):
    """A route that declares its access and authenticates first.

    FastAPI reads a declared body before it solves dependencies; an unauthenticated caller would then learn about
    its JSON before its key. Here the key comes first, then size and type, then the body.
    """

    @property
    def access(self) -> Access:
        """Who may call."""
        for dependency in self.dependencies:
            if isinstance(dependency.dependency, Access):
                return dependency.dependency
        raise UndeclaredAccessError(f"{self.path} declares no access: use needs(), any_key() or public()")

    def get_route_handler(self) -> Handler:
        """Wrap FastAPI's handler."""
        handle = super().get_route_handler()
        access = self.access
        reads_object = self.body_field is not None

        async def guarded(request: Request) -> Response:
            await access.check(request)
            if reads_object:
                require_media_type(request, JSON)
                body = await read_body(request, MAX_OBJECT_BYTES)
                request.state.body = body
                request = JsonRequest(request, body)
            return await handle(request)

        return guarded


def api_router(tag: str) -> APIRouter:
    """Router of one noun."""
    return APIRouter(tags=[tag], route_class=ApiRoute)


def allowed_methods(routers: Sequence[APIRouter], path: str) -> str:
    """Value of the ``Allow`` header of a path: what any route takes there."""
    methods: set[str] = set()
    for router in routers:
        for route in router.routes:
            if isinstance(route, ApiRoute) and route.path_regex.match(path):
                methods |= route.methods or set()
    return ", ".join(sorted(methods | ({"HEAD"} if "GET" in methods else set())))
