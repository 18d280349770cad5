"""Text tables: cells and aligned lines."""

from __future__ import annotations

from collections.abc import Sequence


def layout(rows: Sequence[tuple[str, ...]], *, left: int) -> list[str]:
    """Rows of text as aligned lines, the first ``left`` columns to the left, a rule below the header."""
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    lines = [
        "  ".join(
            cell.ljust(w) if i < left else cell.rjust(w) for i, (cell, w) in enumerate(zip(row, widths, strict=True))
        )
        for row in rows
    ]
    return [lines[0].rstrip(), "-" * len(lines[0]), *(line.rstrip() for line in lines[1:])]


def length_cell(value: float | None) -> str:
    """A length or time in a table."""
    return "-" if value is None else f"{value:.2f}"


def percent_cell(value: float | None) -> str:
    """A share in a table."""
    return "-" if value is None else f"{100 * value:.0f} %"
