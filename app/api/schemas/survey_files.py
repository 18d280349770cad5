"""Reports on files of survey recordings."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated

from pydantic import Field

from app.api.schemas.base import Out, example
from app.api.schemas.surveys import SURVEY_ID, WALK_ID

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
