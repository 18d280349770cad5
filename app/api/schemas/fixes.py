"""Fixes as they are answered: columns, and the last one as an object with its ellipse."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, Any

from pydantic import Field

from app.api.schemas.base import Out, example
from app.engine.types import Fix, FixKind, Hypothesis, Status

CHI2_95 = 5.991464547107979
"""95 % quantile of chi-square with two degrees of freedom."""

_ELLIPSE = {"semi_major_m": 2.9, "semi_minor_m": 1.7, "angle_deg": 31.0}
POSITION_EXAMPLE: dict[str, Any] = {
    "t_ms": 1764000004980.0,
    "kind": "filtered",
    "x": 12.31,
    "y": 4.07,
    "cov_xx": 1.2,
    "cov_xy": 0.3,
    "cov_yy": 0.7,
    "heading_deg": 88.2,
    "status": "ok",
    "quality": 0.83,
    "sure": True,
    "walk_on_m": None,
    "level_id": "lvl_019ab2c4d1e07f3a9b2c4d5e6f",
    "ellipse95": _ELLIPSE,
}
POSITION_EXAMPLE["hypotheses"] = []
FIXES_EXAMPLE: dict[str, Any] = {name: [value] for name, value in POSITION_EXAMPLE.items() if name != "ellipse95"}
FIXED_LAG_EXAMPLE: dict[str, Any] = FIXES_EXAMPLE | {"t_ms": [1763999999840.0], "kind": ["fixed_lag"], "x": [6.12]}


class EllipseOut(Out):
    """The ellipse that holds the truth with 95 %."""

    semi_major_m: float
    semi_minor_m: float
    angle_deg: Annotated[float, Field(description="Of the major axis, counter-clockwise from +x, 0 to 180.")]


class HypothesisOut(Out):
    """One of several places that fit."""

    level_id: str
    x: Annotated[float, Field(description="m, level frame.")]
    y: Annotated[float, Field(description="m, level frame.")]
    cov_xx: Annotated[float, Field(description="m^2.")]
    cov_xy: float
    cov_yy: float
    weight: Annotated[
        float,
        Field(
            description="How likely it is the right place, 0 to 1; the rest of all weights is for places not listed."
        ),
    ]


_KIND = (
    "Which samples it rests on: `filtered` those up to its time, `fixed_lag` also those of about 5 s after it, "
    "`smoothed` all of the session."
)
FIXED_LAG = "Steps that lie 5 s back or more, told once more with what came since; each step once. May be empty."
_HYPOTHESES = "While several places fit: the heaviest of them, heaviest first, with the last fix of a segment."


class PositionOut(Out):
    """One fix."""

    model_config = example(POSITION_EXAMPLE)

    t_ms: Annotated[float, Field(description="Unix milliseconds.")]
    kind: Annotated[FixKind, Field(description=_KIND)]
    x: Annotated[float, Field(description="m, level frame.")]
    y: Annotated[float, Field(description="m, level frame.")]
    cov_xx: Annotated[float, Field(description="m^2.")]
    cov_xy: float
    cov_yy: float
    heading_deg: Annotated[float, Field(description="Direction of motion, counter-clockwise from +x, 0 to 360.")]
    status: Status
    quality: Annotated[float, Field(description="0 (nothing known) to 1.")]
    sure: Annotated[bool, Field(description="Whether the fix may be acted on.")]
    walk_on_m: Annotated[float | None, Field(description="With `insufficient`: about how many more metres to walk.")]
    level_id: str
    hypotheses: Annotated[list[HypothesisOut], Field(description=_HYPOTHESES)]
    ellipse95: EllipseOut


class FixesOut(Out):
    """Fixes in columns, in time order; every column has the same length."""

    model_config = example(FIXES_EXAMPLE)

    t_ms: list[float]
    kind: Annotated[list[FixKind], Field(description=_KIND)]
    x: list[float]
    y: list[float]
    cov_xx: list[float]
    cov_xy: list[float]
    cov_yy: list[float]
    heading_deg: list[float]
    status: list[Status]
    quality: list[float]
    sure: list[bool]
    walk_on_m: list[float | None]
    level_id: list[str]
    hypotheses: Annotated[list[list[HypothesisOut]], Field(description=_HYPOTHESES)]


def t_ms(fix: Fix) -> float:
    """Unix milliseconds; microseconds are as fine as a float64 of seconds is."""
    return round(fix.t * 1000.0, 3)


def heading_deg(fix: Fix) -> float:
    """Degrees counter-clockwise from +x, 0 <= heading < 360."""
    # Rounded last, or the remainder brings the digits back; what rounds up to 360 is 0.
    return round(math.degrees(fix.heading) % 360.0, 2) % 360.0


def ellipse95(fix: Fix) -> dict[str, float]:
    """Half axes and direction of the 95 % ellipse."""
    half_sum = (fix.cov_xx + fix.cov_yy) / 2
    half_difference = (fix.cov_xx - fix.cov_yy) / 2
    spread = math.hypot(half_difference, fix.cov_xy)
    angle = math.degrees(0.5 * math.atan2(fix.cov_xy, half_difference)) % 180.0
    return {
        "semi_major_m": round(math.sqrt(CHI2_95 * max(half_sum + spread, 0.0)), 3),
        "semi_minor_m": round(math.sqrt(CHI2_95 * max(half_sum - spread, 0.0)), 3),
        "angle_deg": round(angle, 1) % 180.0,
    }


def fix_columns(fixes: Sequence[Fix]) -> dict[str, list[Any]]:
    """Fixes as columns, ready for JSON: plain values, for a model per fix would cost more than the rest."""
    return {
        "t_ms": [t_ms(fix) for fix in fixes],
        "kind": [fix.kind.value for fix in fixes],
        "x": [round(fix.x, 3) for fix in fixes],
        "y": [round(fix.y, 3) for fix in fixes],
        "cov_xx": [fix.cov_xx for fix in fixes],
        "cov_xy": [fix.cov_xy for fix in fixes],
        "cov_yy": [fix.cov_yy for fix in fixes],
        "heading_deg": [heading_deg(fix) for fix in fixes],
        "status": [fix.status.value for fix in fixes],
        "quality": [round(fix.quality, 4) for fix in fixes],
        "sure": [fix.sure for fix in fixes],
        "walk_on_m": [fix.walk_on_m for fix in fixes],
        "level_id": [fix.level_id for fix in fixes],
        "hypotheses": [[hypothesis_object(h) for h in fix.hypotheses] for fix in fixes],
    }


def hypothesis_object(h: Hypothesis) -> dict[str, Any]:
    """One of several places as plain values, the shape of HypothesisOut."""
    return {
        "level_id": h.level_id,
        "x": round(h.x, 3),
        "y": round(h.y, 3),
        "cov_xx": round(h.cov_xx, 6),
        "cov_xy": round(h.cov_xy, 6),
        "cov_yy": round(h.cov_yy, 6),
        "weight": round(h.weight, 4),
    }


def position_object(fix: Fix) -> dict[str, Any]:
    """One fix as an object with its ellipse."""
    columns = fix_columns((fix,))
    return {**{name: values[0] for name, values in columns.items()}, "ellipse95": ellipse95(fix)}
