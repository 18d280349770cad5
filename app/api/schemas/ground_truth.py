"""Known positions of sessions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any, Self

from pydantic import Field

from app.api.errors import RejectedError
from app.api.schemas.base import IdRef, In, Metres, Out, PageOut, Time, example
from app.api.validation import FieldError
from app.engine.localization.marks import Mark
from app.engine.types import Status
from app.services.ground_truth_records import TruthPoint

MAX_POINTS = 500
_POINT: dict[str, Any] = {"t_ms": 1790000001500.0, "x": 12.0, "y": 4.5}
_EARLIEST_MS, _LATEST_MS = 946_684_800_000.0, 4_102_444_800_000.0

TRUTH_EXAMPLE: dict[str, Any] = {
    "number": 0,
    **_POINT,
    "level_id": None,
    "sd_m": 0.0,
    "created_at": "2026-11-22T09:30:00.000Z",
    "settled": True,
    "fix": {
        "x": 12.8,
        "y": 4.1,
        "level_id": "lvl_019ab2c4d1e07f3a9b2c4d5e6f",
        "apart_ms": 120.0,
        "error_m": 0.894,
        "normalized_error": 1.1,
        "inside": True,
        "sure": True,
        "status": "ok",
    },
}


_TMs = Annotated[float, Field(strict=True, ge=_EARLIEST_MS, le=_LATEST_MS)]
_Spread = Annotated[float, Field(strict=True, ge=0, le=100)]


class GroundTruthIn(In):
    """Known positions of a session, in columns of one length."""

    model_config = example({"t_ms": [1790000001500.0, 1790000009200.0], "x": [12.0, 20.0], "y": [4.5, 4.5]})

    t_ms: Annotated[
        list[_TMs],
        Field(min_length=1, max_length=MAX_POINTS, description="Unix milliseconds, on the clock of the samples."),
    ]
    x: Annotated[list[Metres], Field(max_length=MAX_POINTS, description="Level metres.")]
    y: Annotated[list[Metres], Field(max_length=MAX_POINTS)]
    level_id: Annotated[
        list[IdRef | None] | None,
        Field(max_length=MAX_POINTS, description="Of a session that may be on several levels; null: whichever."),
    ] = None
    sd_m: Annotated[
        list[_Spread] | None,
        Field(max_length=MAX_POINTS, description="Standard deviation of the place itself, per axis; by default 0."),
    ] = None

    def marks(self) -> list[Mark]:
        """As the services take them; RejectedError for columns of different lengths."""
        n = len(self.t_ms)
        for name in ("x", "y", "level_id", "sd_m"):
            column = getattr(self, name)
            if column is not None and len(column) != n:
                raise RejectedError(
                    [FieldError(name, f"has {len(column)} values, t_ms {n}", "send columns of one length")]
                )
        levels, spreads = self.level_id or [None] * n, self.sd_m or [0.0] * n
        return [
            Mark(t_ms / 1000.0, x, y, level_id, sd_m)
            for t_ms, x, y, level_id, sd_m in zip(self.t_ms, self.x, self.y, levels, spreads, strict=True)
        ]


class ToldOut(Out):
    """What was told at a known position, between two fixes or by the nearest one within a second."""

    x: float
    y: float
    level_id: str
    apart_ms: Annotated[float, Field(description="To the nearest fix.")]
    error_m: Annotated[float, Field(description="Horizontal.")]
    normalized_error: Annotated[
        float, Field(description="Under the claimed covariance (and `sd_m`): 2.45 is the edge of the 95 % ellipse.")
    ]
    inside: Annotated[bool, Field(description="In the 95 % ellipse, and on the right level.")]
    sure: bool
    status: Status


class TruthPointOut(Out):
    """A known position; `fix` is null while none lies within a second, and for good once it is `settled`."""

    model_config = example(TRUTH_EXAMPLE)

    number: int
    t_ms: float
    x: float
    y: float
    level_id: str | None
    sd_m: float
    created_at: Time
    settled: bool
    fix: ToldOut | None

    @classmethod
    def of(cls, point: TruthPoint) -> Self:
        """Show a point."""
        mark, match = point.mark, point.match
        told = match and ToldOut(
            x=match.x,
            y=match.y,
            level_id=match.level_id,
            apart_ms=round(match.apart_s * 1000.0, 3),
            error_m=match.error_m,
            normalized_error=match.normalized,
            inside=match.inside,
            sure=match.sure,
            status=match.status,
        )
        return cls(
            number=point.number,
            t_ms=round(mark.t * 1000.0, 3),
            x=mark.x,
            y=mark.y,
            level_id=mark.level_id,
            sd_m=mark.sd_m,
            created_at=point.created_at,
            settled=point.settled,
            fix=told,
        )


class GroundTruthPage(PageOut):
    """Known positions of a session in the order in which they came."""

    model_config = example({"items": [TRUTH_EXAMPLE], "next_cursor": None})

    items: list[TruthPointOut]

    @classmethod
    def of(cls, points: Sequence[TruthPoint], next_cursor: str | None = None) -> Self:
        """Show a page."""
        return cls(items=[TruthPointOut.of(point) for point in points], next_cursor=next_cursor)
