"""Numbers as text: bounded lines in, exact float32 out."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import BinaryIO

from app.engine.errors import InputError
from app.exchange.maps.document import Value

MAX_LINE = 8 * 2**20
"""Bytes of one line: a row of an ESRI grid with 16 digits for half a million columns."""
_EXACT = "%.9g"
"""Nine digits carry a float32 exactly."""


def exact(value: float) -> str:
    """A float32 in as few digits as carry it."""
    return _EXACT % value


def lines_of(source: BinaryIO, *, longest: int = MAX_LINE) -> Iterator[tuple[int, str]]:
    """Number (from 1) and text of each line, without its end.

    Raises
    ------
    InputError
        A line is longer than ``longest`` bytes.
    """
    number = 0
    while raw := source.readline(longest + 1):
        number += 1
        if len(raw) > longest:
            raise InputError(f"line {number}", f"is longer than {longest} bytes; is this a text file with line ends?")
        if number == 1:
            raw = raw.removeprefix(b"\xef\xbb\xbf")
        yield number, raw.decode("utf-8", "replace").rstrip("\r\n")


def number_at(text: str, line: int, what: str = "a number") -> float:
    """A number of a line; NaN is one, infinity is none."""
    try:
        value = float(text)
    except ValueError:
        value = math.inf
    if math.isinf(value):
        raise InputError(f"line {line}", f"has {text[:40]!r} where {what} should be; send finite numbers, or nan")
    return value


def comment_lines(attributes: Mapping[str, Value]) -> Iterator[str]:
    """Attributes as ``# name: value`` lines."""
    for name, value in attributes.items():
        if isinstance(value, tuple):
            yield f"# {name}: {' '.join(repr(one) for one in value)}"
        else:
            yield f"# {name}: {value if isinstance(value, str) else repr(value)}".replace("\n", " ")


def attribute_of(line: str) -> tuple[str, Value] | None:
    """Inverse of :func:`comment_lines` for one line; None for a comment of another kind."""
    name, colon, text = line.lstrip("# \t").partition(":")
    if not colon or not name.strip():
        return None
    return name.strip(), value_of(text.strip())


def value_of(text: str) -> Value:
    """Text as a number or numbers, if it is all numbers."""
    try:
        numbers = tuple(float(part) for part in text.split())
    except ValueError:
        return text
    return text if not numbers else numbers[0] if len(numbers) == 1 else numbers
