"""Where walks went: their waypoints, without the samples."""

from __future__ import annotations

from dataclasses import dataclass

from app.engine.types import Waypoints
from app.services.records import Walk


@dataclass(frozen=True, slots=True, eq=False)
class WalkTrack:
    """A walk and its waypoints (m, level frame)."""

    walk: Walk
    waypoints: Waypoints
