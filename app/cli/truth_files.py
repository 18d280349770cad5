"""Files of known positions: CSV with a header line."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from app.cli.errors import InputFileError

_AT_ONCE = 500
_NUMBERS = ("t_ms", "x", "y")


def read_truth(file: Path) -> list[dict[str, Any]]:
    """Columns of the file in parts of at most 500 points, as the client takes them.

    Columns ``t_ms``, ``x`` and ``y`` must be there; ``level_id`` and ``sd_m`` may be, and an empty cell means none (0).
    """
    with file.open(newline="", encoding="utf-8-sig") as lines:
        reader = csv.DictReader(lines)
        names = reader.fieldnames or ()
        if missing := [name for name in _NUMBERS if name not in names]:
            raise InputFileError(file, f"no column {', '.join(missing)}; the header must name t_ms, x and y")
        rows = [_row(file, number, row) for number, row in enumerate(reader, start=2)]
    if not rows:
        raise InputFileError(file, "holds no points; add a line for each place")
    return list(_parts(rows, [*_NUMBERS, *(name for name in ("level_id", "sd_m") if name in names)]))


def _row(file: Path, line: int, row: dict[str, str]) -> dict[str, Any]:
    try:
        numbers = {name: float(row[name]) for name in _NUMBERS}
        sd_m = float(row.get("sd_m") or 0.0)
    except (TypeError, ValueError) as error:
        raise InputFileError(file, f"line {line}: {error}; t_ms, x, y and sd_m are numbers") from error
    return {**numbers, "level_id": row.get("level_id") or None, "sd_m": sd_m}


def _parts(rows: list[dict[str, Any]], names: list[str]) -> Iterator[dict[str, Any]]:
    for i in range(0, len(rows), _AT_ONCE):
        part = rows[i : i + _AT_ONCE]
        yield {name: [row[name] for row in part] for name in names}
