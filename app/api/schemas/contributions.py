"""Contributions of sessions to maps, and changes of the field."""

from __future__ import annotations

from dataclasses import fields
from typing import Annotated, Self

from pydantic import Field

from app.api.schemas.base import Out, PageOut, Time, example
from app.api.schemas.devices import DEVICE_ID
from app.api.schemas.levels import LEVEL_ID
from app.api.schemas.maps import MAP_ID
from app.api.schemas.sessions import SESSION_ID
from app.services import records
from app.services.records import ContributionState

CONTRIBUTION_ID = "ctr_019ab2c4d1e07f3a9b2c4d5e6f"
_CONTRIBUTION = {
    "id": CONTRIBUTION_ID,
    "session_id": SESSION_ID,
    "level_id": LEVEL_ID,
    "device_id": DEVICE_ID,
    "contributor": "key_019ab2c4d1e07f3a9b2c4d5e6f",
    "map_id": MAP_ID,
    "state": "used",
    "n_steps": 96,
    "n_kept": 71,
    "n_rows": 139,
    "reasons": ["25 steps: the fix is not sure enough"],
    "box": [12.5, 4.0, 38.2, 17.1],
    "n_agreed": 44,
    "n_disagreed": 2,
    "verdict": "64 of 66 square metres used (confirm 51, refine 13, quarantine 2)",
    "created_at": "2026-11-22T09:42:10.000Z",
    "decided_at": "2026-11-22T09:42:12.000Z",
}
_CHANGE = {
    "id": "chg_019ab2c4d1e07f3a9b2c4d5e6f",
    "level_id": LEVEL_ID,
    "map_id": MAP_ID,
    "box": [20.0, 8.0, 25.0, 13.0],
    "area_m2": 24.0,
    "delta": [1.1, -3.9, 14.2],
    "after": "2026-11-20T17:02:00.000Z",
    "before": "2026-11-21T08:11:00.000Z",
    "created_at": "2026-11-22T09:42:12.000Z",
}
Box = Annotated[list[float], Field(min_length=4, max_length=4, description="x_min, y_min, x_max, y_max, m.")]


class ContributionOut(Out):
    """What a session offered to the map of a level, and what became of it."""

    model_config = example(_CONTRIBUTION)

    id: str
    session_id: str
    level_id: str
    device_id: str | None
    contributor: Annotated[str, Field(description="Key that opened the session; of one key all is one witness.")]
    map_id: Annotated[str, Field(description="Version on which the session was located.")]
    state: Annotated[
        ContributionState,
        Field(
            description="`offered`: not yet weighed. `used`: counts in the map, in part at least. `waiting`: for an "
            "independent contributor. `quarantined`: contradicts others, or physics. `rejected`: by a person. `empty`: "
            "nothing was sure enough."
        ),
    ]
    n_steps: Annotated[int, Field(description="Steps of the session.")]
    n_kept: Annotated[int, Field(description="Of these sure enough to be offered.")]
    n_rows: Annotated[int, Field(description="Rows of evidence made of these.")]
    reasons: Annotated[list[str], Field(description="Why steps were left out.")]
    box: Annotated[Box | None, Field(description="Where the rows lie: x_min, y_min, x_max, y_max, m.")]
    n_agreed: Annotated[int, Field(description="Places where independent evidence agrees.")]
    n_disagreed: int
    verdict: Annotated[str, Field(description="What the weighing did with it, in words; empty before.")]
    created_at: Time
    decided_at: Time | None

    @classmethod
    def of(cls, contribution: records.Contribution) -> Self:
        """Show a contribution."""
        plain = {item.name: getattr(contribution, item.name) for item in fields(contribution)}
        box = None if contribution.box is None else list(contribution.box)
        return cls(**{**plain, "reasons": list(contribution.reasons), "box": box})


class ContributionPage(PageOut):
    """Contributions, newest first."""

    model_config = example({"items": [_CONTRIBUTION], "next_cursor": None})

    items: list[ContributionOut]


class LastingChangeOut(Out):
    """A lasting change of the field that independent passes agree on."""

    model_config = example(_CHANGE)

    id: str
    level_id: str
    map_id: Annotated[str, Field(description="Version from which on the map shows it.")]
    box: Box
    area_m2: float
    delta: Annotated[list[float], Field(description="Mean change per channel of the map, uT.")]
    after: Annotated[Time | None, Field(description="Last pass that agreed with the old field; null: none known.")]
    before: Annotated[Time | None, Field(description="First pass that did not.")]
    created_at: Time

    @classmethod
    def of(cls, change: records.LastingChange) -> Self:
        """Show a change."""
        plain = {item.name: getattr(change, item.name) for item in fields(change)}
        return cls(**{**plain, "box": list(change.box), "delta": list(change.delta)})


class LastingChangePage(PageOut):
    """Changes of the field, newest first."""

    model_config = example({"items": [_CHANGE], "next_cursor": None})

    items: list[LastingChangeOut]
