"""Keys and scopes: who asks, and whether it may.

A route declares its access with ``dependencies=[needs(Scope.SURVEY)]``, ``[any_key()]`` or ``[public()]``. The route
class of :mod:`app.api.routing` checks it before the body is read.
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable
from dataclasses import dataclass
from threading import Lock
from typing import TYPE_CHECKING

from fastapi import Depends, Request, Security
from fastapi.params import Depends as DependsParam
from fastapi.security import APIKeyHeader, HTTPBearer
from starlette.concurrency import run_in_threadpool
from starlette.requests import HTTPConnection

from app.api.errors import RateLimitedError, UnauthorizedError
from app.services.errors import ForbiddenError
from app.services.records import ApiKey, Scope

if TYPE_CHECKING:
    from app.api.deps import Context

_BEARER = HTTPBearer(auto_error=False, scheme_name="bearer", description="`Authorization: Bearer <key>`")
_HEADER = APIKeyHeader(name="X-API-Key", auto_error=False, scheme_name="header", description="`X-API-Key: <key>`")

KEY_CACHE_S = 10.0
"""How long a verified key is trusted without asking the database: a key revoked by *another* process works so long."""
_MAX_CACHED = 10_000
_MAX_SECRET = 200


class KeyCache:
    """Verified keys by the hash of their secret, for a few seconds each."""

    def __init__(self, verify: Callable[[str], ApiKey | None], clock: Callable[[], float] = time.monotonic) -> None:
        self._verify = verify
        self._clock = clock
        self._known: dict[bytes, tuple[ApiKey, float]] = {}
        self._generation = 0
        self._lock = Lock()

    def cached(self, secret: str) -> ApiKey | None:
        """Return a key verified lately, without blocking."""
        found = self._known.get(_digest(secret))
        return found[0] if found is not None and found[1] > self._clock() else None

    def verify(self, secret: str) -> ApiKey | None:
        """Ask the accounts; blocks."""
        generation = self._generation
        key = self._verify(secret)
        if key is not None:
            with self._lock:
                # A revocation that came in between must not be overwritten by what was read before it.
                if generation == self._generation:
                    if len(self._known) >= _MAX_CACHED:
                        self._known.clear()
                    self._known[_digest(secret)] = (key, self._clock() + KEY_CACHE_S)
        return key

    def forget_all(self) -> None:
        """Drop everything: a key was revoked."""
        with self._lock:
            self._generation += 1
            self._known.clear()


@dataclass(frozen=True, slots=True)
class Access:
    """What a route asks of its caller. Called as a dependency it yields the key that was checked before."""

    scope: Scope | None
    public: bool = False
    by_token: bool = False
    """Open to whoever has the token in the path, which the route checks itself."""

    async def check(self, request: Request) -> None:
        """Authenticate, count against the rate limit, and compare the scope."""
        if self.public:
            return
        context: Context = request.app.state.context
        key = await authenticate(context.keys, secret_of(request))
        request.state.key = key
        quota = context.limiter.take(key.id)
        request.state.quota = quota
        if quota is not None and not quota.allowed:
            raise RateLimitedError(quota.retry_after_s)
        if self.scope is not None and not has_scope(key, self.scope):
            raise ForbiddenError(self.scope.value)

    def __call__(
        self, request: Request, _bearer: object = Security(_BEARER), _header: object = Security(_HEADER)
    ) -> ApiKey:
        """Hand over the checked key; a route that was never checked is refused."""
        return current_key(request)


def needs(scope: Scope) -> DependsParam:
    """Declare that a route needs this scope (``admin`` includes all)."""
    return _depends(Access(scope))


def any_key() -> DependsParam:
    """Declare that a route is open to every valid key."""
    return _depends(Access(None))


def public() -> DependsParam:
    """Declare that a route is open to everybody."""
    return _depends(_PublicAccess(None, public=True))


def by_token() -> DependsParam:
    """Declare that a route checks a token in its path itself."""
    return _depends(_PublicAccess(None, public=True, by_token=True))


def current_key(request: Request) -> ApiKey:
    """Return the key this request was authenticated with."""
    key = getattr(request.state, "key", None)
    if not isinstance(key, ApiKey):
        raise UnauthorizedError("this path was reached without a check of the key")
    return key


def has_scope(key: ApiKey, scope: Scope) -> bool:
    """Whether the key may do this."""
    return scope in key.scopes or Scope.ADMIN in key.scopes


class _PublicAccess(Access):
    """Access without a key: nothing to hand over, no security scheme in OpenAPI."""

    def __call__(self) -> None:  # type: ignore[override]
        """Do nothing."""


def scope_word(access: Access) -> str:
    """What a route asks of its caller, in a word: a scope, ``any`` key, ``token`` in the path, ``none``."""
    if access.public:
        return "token" if access.by_token else "none"
    return "any" if access.scope is None else access.scope.value


def _depends(access: Access) -> DependsParam:
    marker: DependsParam = Depends(access)
    return marker


async def authenticate(keys: KeyCache, secret: str) -> ApiKey:
    """Return the key of a secret; UnauthorizedError if there is none, or it was revoked."""
    # The loop is not left for a key seen lately: a thread hop and a query cost more than the rest of a small call.
    key = keys.cached(secret) or await run_in_threadpool(keys.verify, secret)
    if key is None:
        raise UnauthorizedError("this API key is not known, or it was revoked")
    return key


async def is_known(keys: KeyCache, secret: str) -> bool:
    """Whether a secret is that of a key still: streams outlive revocations."""
    try:
        await authenticate(keys, secret)
    except UnauthorizedError:
        return False
    return True


def secret_of(request: HTTPConnection) -> str:
    """Return the secret that the headers of a request (or of a WebSocket's handshake) hold."""
    scheme, _, credentials = request.headers.get("authorization", "").partition(" ")
    bearer = credentials.strip() if scheme.lower() == "bearer" else None
    header = request.headers.get("x-api-key")
    if header is None and bearer is None:
        raise UnauthorizedError("send `Authorization: Bearer <key>` or `X-API-Key: <key>`")
    if header is not None and bearer is not None and header.strip() != bearer:
        raise UnauthorizedError("Authorization and X-API-Key hold different keys; send one of them")
    secret = (bearer if header is None else header.strip()) or ""
    if not 0 < len(secret) <= _MAX_SECRET:
        raise UnauthorizedError("the API key is empty or too long")
    return secret


def _digest(secret: str) -> bytes:
    return hashlib.sha256(secret.encode()).digest()
