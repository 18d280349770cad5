"""Words of the query of files."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated

from pydantic import Field

from app.api.validation import LINE_PATTERN

Line = Annotated[str, Field(max_length=500, pattern=LINE_PATTERN)]
"""A line of free text."""


class FieldChannel(StrEnum):
    """What a layer of a map is of the field."""

    X = "x"
    Y = "y"
    Z = "z"
    H = "h"
    V = "v"
    TOTAL = "total"


class FieldUnit(StrEnum):
    """Units of a map's field."""

    MICROTESLA = "uT"
    NANOTESLA = "nT"
