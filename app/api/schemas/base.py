"""What all schemas share."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, PlainSerializer, WithJsonSchema

from app.api.validation import ID_PATTERN, LINE_PATTERN, NAME_PATTERN

Name = Annotated[str, Field(min_length=1, max_length=200, pattern=NAME_PATTERN)]
IdRef = Annotated[str, Field(min_length=1, max_length=64, pattern=ID_PATTERN)]
Epoch = Annotated[str, Field(max_length=64, pattern=LINE_PATTERN)]
Number = Annotated[float, Field(strict=True)]
Metres = Annotated[float, Field(strict=True, ge=-1e6, le=1e6)]
Integer = Annotated[int, Field(strict=True)]


Distance = Annotated[
    float | None,
    Field(description="Metres from the place named in `near` to the bounding box (0: inside); null without `near`."),
]


def _iso(value: datetime) -> str:
    return value.isoformat(timespec="milliseconds").replace("+00:00", "Z")


Time = Annotated[
    datetime,
    PlainSerializer(_iso, return_type=str),
    WithJsonSchema({"type": "string", "format": "date-time", "examples": ["2026-11-22T09:30:00.000Z"]}),
]


class In(BaseModel):
    """A request: unknown fields, NaN and infinities are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Out(BaseModel):
    """An answer."""

    model_config = ConfigDict(frozen=True)


class PageOut(Out):
    """One page of a list; the ``Link`` header names the next one too."""

    next_cursor: Annotated[
        str | None, Field(description="Send as `cursor` to get the next page; null on the last one.")
    ] = None


def example(value: dict[str, Any]) -> ConfigDict:
    """Model configuration with one example."""
    return ConfigDict(json_schema_extra={"examples": [value]})
