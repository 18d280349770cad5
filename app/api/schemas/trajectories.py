"""Smoothed trajectories of sessions."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field

from app.api.schemas.base import Out, example
from app.api.schemas.fixes import FIXES_EXAMPLE, FixesOut, fix_columns
from app.api.schemas.levels import LEVEL_ID
from app.api.schemas.maps import MAP_ID
from app.api.schemas.places import MapIdOut, MapsOut, maps_object
from app.api.schemas.sessions import SESSION_ID
from app.engine.localization.registry import DEFAULT_METHOD
from app.engine.types import FixKind
from app.services.records import Trajectory


class TrajectoryOut(Out):
    """A session's trajectory from the samples of both sides in time: for afterwards, not for the moment."""

    model_config = example(
        {
            "session_id": SESSION_ID,
            "map_id": MAP_ID,
            "maps": [{"level_id": LEVEL_ID, "map_id": MAP_ID}],
            "method": DEFAULT_METHOD,
            "kind": FixKind.SMOOTHED,
            "fixes": FIXES_EXAMPLE | {"kind": [FixKind.SMOOTHED]},
        }
    )

    session_id: str
    map_id: MapIdOut
    maps: MapsOut
    method: str
    kind: Annotated[
        Literal[FixKind.SMOOTHED], Field(description="Not what was answered in the moment: see `positions`.")
    ]
    fixes: Annotated[
        FixesOut, Field(description="One per step; steps before the place was found may be `filtered` still.")
    ]


def trajectory_object(trajectory: Trajectory) -> dict[str, Any]:
    """Return the answer as plain values, the shape of TrajectoryOut."""
    return {
        "session_id": trajectory.session_id,
        **maps_object(trajectory.level_id, trajectory.maps),
        "method": trajectory.method,
        "kind": FixKind.SMOOTHED.value,
        "fixes": fix_columns(trajectory.fixes),
    }
