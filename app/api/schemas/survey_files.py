"""Reports on files of survey recordings, and the lines that walks followed."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated, Self

from pydantic import Field

from app.api.schemas.base import Out, PageOut, example
from app.api.schemas.surveys import SURVEY_ID, WALK_ID
from app.engine.types import Waypoints
from app.services import records

_LINE = {"walk_id": WALK_ID, "name": "corridor, there and back", "t_ms": [1790000000000.0, 1790000009500.0]}
_PLACES = {"x": [3.0, 14.5], "y": [2.0, 2.0]}


class WalkFate(StrEnum):
    """What became of a walk of a file."""

    NEW = "new"
    KNOWN = "known"
    REFUSED = "refused"


class ImportedWalkOut(Out):
    """One walk that was found in a file."""

    name: str
    fate: Annotated[
        WalkFate,
        Field(description="`known`: the survey has it already. `refused`: it cannot be used; `reasons` say why."),
    ]
    walk_id: Annotated[str | None, Field(description="Where it is stored; null: it is not.")]
    n_samples: int
    n_waypoints: int
    duration_s: float
    reasons: list[str]
    x: Annotated[list[float], Field(description="Its waypoints, level metres.")]
    y: list[float]


class SurveyImportOut(Out):
    """What was read of a file, what was taken for what, and what was left out and why."""

    model_config = example(
        {
            "survey_id": SURVEY_ID,
            "dry_run": False,
            "walks": [
                {
                    "name": "walk1",
                    "fate": "new",
                    "walk_id": WALK_ID,
                    "n_samples": 475,
                    "n_waypoints": 2,
                    "duration_s": 9.5,
                    "reasons": [],
                    **_PLACES,
                }
            ],
            "read": ["walk1: 475 samples, 2 positions"],
            "assumed": ["mag is taken for uT"],
            "skipped": ["3 of 478 lines that cannot be read; the first: line 17"],
        }
    )

    survey_id: str
    dry_run: Annotated[bool, Field(description="True: nothing was stored.")]
    walks: list[ImportedWalkOut]
    read: list[str]
    assumed: list[str]
    skipped: list[str]


class WalkLineOut(Out):
    """The waypoints of a walk."""

    model_config = example({**_LINE, **_PLACES})

    walk_id: str
    name: str
    t_ms: Annotated[list[float], Field(description="Unix milliseconds.")]
    x: Annotated[list[float], Field(description="Level metres.")]
    y: list[float]

    @classmethod
    def of(cls, walk: records.Walk, waypoints: Waypoints) -> Self:
        """Show the line of a walk."""
        t_ms = (1000.0 * waypoints.t).tolist()
        return cls(walk_id=walk.id, name=walk.name, t_ms=t_ms, x=waypoints.x.tolist(), y=waypoints.y.tolist())


class WalkLinePage(PageOut):
    """Lines of walks, oldest first."""

    model_config = example({"items": [{**_LINE, **_PLACES}], "next_cursor": None})

    items: list[WalkLineOut]
