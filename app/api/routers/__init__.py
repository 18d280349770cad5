"""One router a noun."""

from app.api.routers import (
    contributions,
    device_models,
    devices,
    health,
    jobs,
    keys,
    levels,
    locate,
    maps,
    methods,
    planning,
    positions,
    replays,
    segments,
    sessions,
    stats,
    surveys,
    trajectories,
    venues,
    versions,
)

ROUTERS = (
    health.router,
    venues.router,
    levels.router,
    devices.router,
    device_models.router,
    surveys.router,
    maps.router,
    versions.router,
    planning.router,
    sessions.router,
    contributions.router,
    segments.router,
    positions.router,
    trajectories.router,
    replays.router,
    locate.router,
    jobs.router,
    methods.router,
    keys.router,
    stats.router,
)

__all__ = ["ROUTERS"]
