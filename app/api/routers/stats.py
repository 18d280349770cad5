"""Counts for operators."""

from __future__ import annotations

from app.api.auth import needs
from app.api.deps import ServicesDep
from app.api.responses import guarded
from app.api.routing import api_router
from app.api.schemas.stats import StatsOut
from app.services.records import Scope

router = api_router("stats")


@router.get("/v1/stats", summary="Read counts", dependencies=[needs(Scope.ADMIN)], responses=guarded())
def get_stats(services: ServicesDep) -> StatsOut:
    """Counts of everything stored."""
    return StatsOut.of(services.stats.stats())
