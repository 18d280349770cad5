"""One router a noun."""

from app.api.routers import (
    devices,
    exchange,
    health,
    jobs,
    keys,
    levels,
    locate,
    maps,
    methods,
    positions,
    segments,
    sessions,
    stats,
    surveys,
    trajectories,
    venues,
)

ROUTERS = (
    health.router,
    venues.router,
    levels.router,
    devices.router,
    surveys.router,
    maps.router,
    exchange.router,
    sessions.router,
    segments.router,
    positions.router,
    trajectories.router,
    locate.router,
    jobs.router,
    methods.router,
    keys.router,
    stats.router,
)

__all__ = ["ROUTERS"]
