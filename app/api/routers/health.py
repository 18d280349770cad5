"""Health, readiness, metrics: for those who run the service; no key."""

from __future__ import annotations

from fastapi import Response
from prometheus_client import CONTENT_TYPE_LATEST

from app.api import errors
from app.api.auth import public
from app.api.deps import ContextDep
from app.api.errors import NotReadyError
from app.api.responses import problems
from app.api.routing import api_router
from app.api.schemas.health import HealthOut, ReadyOut

router = api_router("health")


@router.get("/healthz", summary="Is the process alive?", dependencies=[public()])
async def healthz() -> HealthOut:
    """Answers as long as the process does; nothing else is asked."""
    return HealthOut(status="ok")


@router.get(
    "/readyz",
    summary="Is the service ready for work?",
    dependencies=[public()],
    responses=problems(errors.NOT_READY),
)
def readyz(context: ContextDep) -> ReadyOut:
    """Whether database and workers work; 503 names the part that does not."""
    parts = dict(context.ready())
    if not all(parts.values()):
        raise NotReadyError([name for name, works in parts.items() if not works])
    return ReadyOut(status="ready", parts=parts)


@router.get(
    "/metrics",
    summary="Metrics for Prometheus",
    dependencies=[public()],
    response_class=Response,
    responses={
        200: {
            "description": "Prometheus text format; docs/metrics.md lists all.",
            "content": {"text/plain": {"schema": {"type": "string"}}},
        }
    },
)
def metrics(context: ContextDep) -> Response:
    """All metrics of this process."""
    return Response(context.metrics.render(), media_type=CONTENT_TYPE_LATEST)
