"""Annotations as positions: "x,y" in level metres, or the name of a place that is known (a marker)."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence

import numpy as np

from app.engine.types import Waypoints
from app.exchange.phones.collecting import from_text
from app.exchange.phones.errors import FormatError
from app.exchange.phones.readings import NS, Annotation
from app.exchange.phones.recorded import Table
from app.exchange.surveys.recording import rising

MAX_METRES = 1e6
MAX_MARKERS = 100_000
MAX_MARKER_BYTES = 16 * 2**20
_LABELS = re.compile(r"\b[xy]\s*[=:]\s*|(?<=\d)\s*m\b", re.IGNORECASE)
_BETWEEN = re.compile(r"[;/|\s]+")
Markers = Mapping[str, tuple[float, float]]
"""Names, as :func:`marker_key` makes them of what was written, to x and y (m, level frame)."""


def marker_key(name: str) -> str:
    """A marker's name without what users write differently: case and spaces around."""
    return " ".join(name.split()).casefold()


def waypoints_of(notes: Sequence[Annotation], markers: Markers) -> tuple[Waypoints, tuple[str, ...]]:
    """Positions that annotations name, and the texts of those that name none.

    Parameters
    ----------
    notes : sequence of Annotation
        In time order; of several at one moment the first counts.
    markers : mapping
    """
    placed = [(note.t_ns, position) for note in notes if (position := position_of(note.text, markers)) is not None]
    others = tuple(note.text for note in notes if position_of(note.text, markers) is None)
    t = np.array([t_ns // 1000 for t_ns, _ in placed], np.float64) / (NS / 1000)
    xy = np.array([position for _, position in placed], np.float64).reshape(-1, 2)
    fresh = rising(t)
    return Waypoints(t[fresh], xy[fresh, 0], xy[fresh, 1]), others


def position_of(text: str, markers: Markers) -> tuple[float, float] | None:
    """The position that a text names; None if it names none.

    Markers come first. Of numbers many spellings are taken, for some applications strip commas: ``12.5,40``,
    ``12.5 40``, ``12,5; 40``, ``x=12.5 y=40 m``.
    """
    if (known := markers.get(marker_key(text))) is not None:
        return known
    plain = _LABELS.sub(" ", text[:100]).strip().strip("()[]").strip()
    parts = [part.strip(",") for part in _BETWEEN.split(plain) if part.strip(",")]
    if len(parts) == 1:
        parts = parts[0].split(",")
    numbers = [_metres(part) for part in parts]
    if len(numbers) != 2 or numbers[0] is None or numbers[1] is None:
        return None
    return numbers[0], numbers[1]


def _metres(text: str) -> float | None:
    if not re.fullmatch(r"[-+]?\d{1,7}(?:[.,]\d{0,9})?", text.strip(), re.ASCII):
        return None
    value = float(text.strip().replace(",", "."))
    return value if abs(value) <= MAX_METRES else None


def read_markers(content: bytes) -> dict[str, tuple[float, float]]:
    """Markers of a CSV table (:func:`marker_rows`), by key."""
    return {marker_key(name): (x, y) for name, x, y in marker_rows(content)}


def marker_rows(content: bytes) -> list[tuple[str, float, float]]:
    """Names, ``x`` and ``y`` (level metres) of a CSV table with these columns, each name once.

    Raises
    ------
    FormatError
        Names the line and the remedy.
    """
    if len(content) > MAX_MARKER_BYTES:
        raise FormatError("markers", f"has {len(content)} bytes; at most {MAX_MARKER_BYTES} are read")
    table = Table.of("markers", content)
    header = [] if table is None else [name.lower() for name in table.header]
    missing = [name for name in ("name", "x", "y") if name not in header]
    if table is None or missing:
        raise FormatError("markers header", f"lacks {', '.join(missing)}; write a line name,x,y above the markers")
    name, x, y = (header.index(one) for one in ("name", "x", "y"))
    markers: dict[str, tuple[str, float, float]] = {}
    for line, row in table.rows():
        if len(row) <= max(name, x, y) or not row[name].strip():
            if any(cell.strip() for cell in row):
                raise FormatError(f"markers line {line}", "lacks name, x or y; complete or remove it")
            continue
        place = (_coordinate(row[x], line, "x"), _coordinate(row[y], line, "y"))
        known = markers.setdefault(marker_key(row[name]), (row[name].strip(), *place))
        if known[1:] != place or len(markers) > MAX_MARKERS:
            raise FormatError(f"markers line {line}", f"names {row[name][:40]!r} once more; each name has one place")
    return list(markers.values())


def _coordinate(text: str, line: int, axis: str) -> float:
    value = from_text(text, f"markers line {line}: {axis}")
    if math.isnan(value) or abs(value) > MAX_METRES:
        raise FormatError(f"markers line {line}: {axis}", f"is {text[:40]!r}; send metres of the level's plan")
    return value
