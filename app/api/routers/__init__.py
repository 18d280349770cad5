"""One router a noun."""

from app.api.routers import (
    device_models,
    devices,
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
    device_models.router,
    surveys.router,
    maps.router,
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
