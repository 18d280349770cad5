"""Assembly of the FastAPI application."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractAsyncContextManager
from importlib.metadata import PackageNotFoundError, version

import anyio
from fastapi import APIRouter, FastAPI
from fastapi.middleware.cors import CORSMiddleware

from app.api import docs_page, errors, openapi
from app.api.auth import KeyCache
from app.api.deps import Context
from app.api.idempotency import Creations
from app.api.middleware import AnswerMiddleware
from app.api.ports import ApiSettings, Broker, Hub, Metrics, Readiness
from app.api.ratelimit import RateLimiter
from app.api.routers import ROUTERS
from app.api.routing import allowed_methods
from app.services.clock import Clock, utc_now
from app.services.container import Services

Lifespan = Callable[[FastAPI], AbstractAsyncContextManager[None]]

_LARGE_UPLOADS = 2
_LOCATES = 16
_SMOOTHINGS = 1


def create_api(
    *,
    services: Services,
    broker: Broker,
    hub: Hub,
    settings: ApiSettings,
    metrics: Metrics,
    ready: Readiness,
    clock: Clock = utc_now,
    lifespan: Lifespan | None = None,
    pages: Sequence[APIRouter] = (),
) -> FastAPI:
    """Build the application over ready-made services.

    ``lifespan`` starts and stops what they need; ``pages`` are served beside the API.
    """
    app = FastAPI(
        title="Isodyn",
        version=_version(),
        summary="Geomagnetic positioning: segments of magnetometer and inertial samples in, positions out.",
        description=openapi.DESCRIPTION,
        openapi_tags=openapi.TAGS,
        openapi_url=None,  # /openapi.json and /docs are routes like all others: see docs_page
        docs_url=None,
        redoc_url=None,
        lifespan=lifespan,
        separate_input_output_schemas=False,
        # Generated clients name their functions after these.
        generate_unique_id_function=lambda route: route.name,
    )
    limiter = RateLimiter(settings.rate_limit_per_minute, settings.rate_limit_burst)
    app.state.context = Context(
        services=services,
        broker=broker,
        hub=hub,
        settings=settings,
        metrics=metrics,
        ready=ready,
        keys=KeyCache(services.accounts.verify),
        limiter=limiter,
        creations=Creations(services.idempotency),
        clock=clock,
        uploads=anyio.CapacityLimiter(_LARGE_UPLOADS),
        locates=anyio.CapacityLimiter(_LOCATES),
        smoothings=anyio.CapacityLimiter(_SMOOTHINGS),
    )
    routers = (*ROUTERS, docs_page.router, *pages)
    for router in routers:
        app.include_router(router)
    errors.install(app, lambda path: allowed_methods(routers, path))
    openapi.install(app)
    if settings.cors_origins:
        app.add_middleware(
            CORSMiddleware,
            allow_origins=list(settings.cors_origins),
            allow_methods=["*"],
            allow_headers=["*"],
            expose_headers=["*"],
        )
    # Added last, so outermost: it counts what CORS answers too.
    app.add_middleware(AnswerMiddleware, metrics=metrics, policy=limiter.policy)
    return app


def _version() -> str:
    try:
        return version("isodyn")
    except PackageNotFoundError:
        return "0+unknown"
