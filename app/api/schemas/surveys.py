"""Surveys and their walks."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import Field

from app.api.schemas.base import IdRef, In, Name, Out, PageOut, Time, example
from app.api.schemas.levels import LEVEL_ID
from app.services import records

SURVEY_ID = "srv_019ab2c4d1e07f3a9b2c4d5e6f"
WALK_ID = "wlk_019ab2c4d1e07f3a9b2c4d5e6f"
_SURVEY = {
    "id": SURVEY_ID,
    "level_id": LEVEL_ID,
    "name": "spring survey",
    "n_walks": 12,
    "created_at": "2026-11-22T09:30:00.000Z",
}
_WALK = {
    "id": WALK_ID,
    "survey_id": SURVEY_ID,
    "name": "corridor, there and back",
    "device_id": None,
    "calibration_epoch": "",
    "n_samples": 3120,
    "n_waypoints": 9,
    "duration_s": 62.4,
    "length_m": 71.3,
    "content_hash": "0b1a6f0f5f8f0c9a2d0d8a9e1d9a0a2b3c4d5e6f708192a3b4c5d6e7f8091a2b",
    "created_at": "2026-11-22T09:30:00.000Z",
}


class SurveyIn(In):
    """A survey to create."""

    model_config = example({"level_id": LEVEL_ID, "name": "spring survey"})

    level_id: IdRef
    name: Name


class SurveyOut(Out):
    """Walks with known positions on one level."""

    model_config = example(_SURVEY)

    id: str
    level_id: str
    name: str
    n_walks: int
    created_at: Time

    @classmethod
    def of(cls, survey: records.Survey) -> Self:
        """Show a survey."""
        return cls(
            id=survey.id,
            level_id=survey.level_id,
            name=survey.name,
            n_walks=survey.n_walks,
            created_at=survey.created_at,
        )


class SurveyPage(PageOut):
    """Surveys, newest first."""

    model_config = example({"items": [_SURVEY], "next_cursor": None})

    items: list[SurveyOut]


class WalkOut(Out):
    """A stored survey walk, without its samples."""

    model_config = example(_WALK)

    id: str
    survey_id: str
    name: str
    device_id: str | None
    calibration_epoch: str
    n_samples: int
    n_waypoints: int
    duration_s: float
    length_m: Annotated[float, Field(description="Sum of the straight legs between waypoints.")]
    content_hash: Annotated[str, Field(description="SHA-256 of samples and waypoints; the name does not count.")]
    created_at: Time

    @classmethod
    def of(cls, walk: records.Walk) -> Self:
        """Show a walk."""
        return cls(
            id=walk.id,
            survey_id=walk.survey_id,
            name=walk.name,
            device_id=walk.device_id,
            calibration_epoch=walk.calibration_epoch,
            n_samples=walk.n_samples,
            n_waypoints=walk.n_waypoints,
            duration_s=walk.duration_s,
            length_m=walk.length_m,
            content_hash=walk.content_hash,
            created_at=walk.created_at,
        )


class WalkPage(PageOut):
    """Walks of a survey, oldest first."""

    model_config = example({"items": [_WALK], "next_cursor": None})

    items: list[WalkOut]
