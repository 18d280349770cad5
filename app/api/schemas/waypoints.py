"""Where walks went."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import Field

from app.api.schemas.base import Out, PageOut, example
from app.api.schemas.surveys import SURVEY_ID, WALK_ID
from app.services.walk_tracks import WalkTrack

_TRACK = {
    "walk_id": WALK_ID,
    "survey_id": SURVEY_ID,
    "name": "corridor, there and back",
    "t_ms": [1795512600000, 1795512612500],
    "x": [12.0, 24.5],
    "y": [4.0, 4.0],
}


class WalkTrackOut(Out):
    """The waypoints of a walk, as columns of one length."""

    model_config = example(_TRACK)

    walk_id: str
    survey_id: str
    name: str
    t_ms: Annotated[list[int], Field(description="Unix milliseconds.")]
    x: Annotated[list[float], Field(description="Level metres.")]
    y: list[float]

    @classmethod
    def of(cls, track: WalkTrack) -> Self:
        """Show where a walk went."""
        walk, marks = track.walk, track.waypoints
        return cls(
            walk_id=walk.id,
            survey_id=walk.survey_id,
            name=walk.name,
            t_ms=[round(1000.0 * t) for t in marks.t.tolist()],
            x=[round(v, 3) for v in marks.x.tolist()],
            y=[round(v, 3) for v in marks.y.tolist()],
        )


class WalkTrackPage(PageOut):
    """Where the walks of a level went, oldest first."""

    model_config = example({"items": [_TRACK], "next_cursor": None})

    items: list[WalkTrackOut]
