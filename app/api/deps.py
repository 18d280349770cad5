"""What endpoints are given: the context of the process, the caller's key, wishes in headers."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Annotated

import anyio
from fastapi import Depends, Path, Request

from app.api.auth import KeyCache, current_key
from app.api.idempotency import Creations
from app.api.ports import ApiSettings, Broker, Hub, Metrics, Readiness
from app.api.ratelimit import RateLimiter
from app.api.schemas.samples import MAX_SEQ
from app.services.clock import Clock
from app.services.container import Services
from app.services.records import ApiKey

_WAIT = re.compile(r"(?:^|[,;])\s*wait\s*=\s*\"?(\d{1,6}(?:\.\d{1,3})?)\"?\s*(?=[,;]|$)", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class Context:
    """Everything the endpoints of one application share."""

    services: Services
    broker: Broker
    hub: Hub
    settings: ApiSettings
    metrics: Metrics
    ready: Readiness
    keys: KeyCache
    limiter: RateLimiter
    creations: Creations
    clock: Clock
    uploads: anyio.CapacityLimiter
    """How many large uploads are decoded at once: each may hold several times its size in memory."""
    locates: anyio.CapacityLimiter
    """How many one-shot locations may block a thread at once."""
    smoothings: anyio.CapacityLimiter
    """How many trajectories are smoothed at once: each keeps a worker busy for seconds."""


@dataclass(frozen=True, slots=True)
class Wait:
    """How long the caller would wait for a result (RFC 7240); 0: not at all."""

    seconds: float

    @property
    def applied(self) -> dict[str, str]:
        """Header that says the wish was honoured."""
        return {"Preference-Applied": f"wait={self.seconds:g}"} if self.seconds else {}


async def _context(request: Request) -> Context:
    context: Context = request.app.state.context
    return context


async def _services(request: Request) -> Services:
    context: Context = request.app.state.context
    return context.services


async def _wait(request: Request) -> Wait:
    found = _WAIT.search(",".join(request.headers.getlist("prefer")))
    context: Context = request.app.state.context
    return Wait(min(float(found.group(1)), context.settings.max_wait_s) if found else 0.0)


async def _key(request: Request) -> ApiKey:
    return current_key(request)


ContextDep = Annotated[Context, Depends(_context)]
ServicesDep = Annotated[Services, Depends(_services)]
WaitDep = Annotated[Wait, Depends(_wait)]
KeyDep = Annotated[ApiKey, Depends(_key)]

SeqPath = Annotated[int, Path(ge=0, le=MAX_SEQ, description="Number of the segment, from 0.")]

PREFER_PARAMETER = {
    "name": "Prefer",
    "in": "header",
    "required": False,
    "description": "`wait=N`: hold the answer up to N seconds (at most 30) for the result.",
    "schema": {"type": "string"},
    "example": "wait=5",
}
