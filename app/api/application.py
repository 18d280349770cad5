"""Assembly of the FastAPI application."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractAsyncContextManager
from typing import TYPE_CHECKING

from fastapi import FastAPI

from app.api.ports import ApiSettings, Broker, Metrics, Readiness

if TYPE_CHECKING:
    from app.services.container import Services

Lifespan = Callable[[FastAPI], AbstractAsyncContextManager[None]]


def create_api(
    *,
    services: Services,
    broker: Broker,
    settings: ApiSettings,
    metrics: Metrics,
    ready: Readiness,
    lifespan: Lifespan | None = None,
) -> FastAPI:
    """Build the application over ready-made services; ``lifespan`` starts and stops what they need."""
    raise NotImplementedError
