"""Tables as CSV (RFC 4180), for those who ask: ``?format=csv`` or ``Accept: text/csv``."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from enum import StrEnum
from typing import Annotated, Any

from fastapi import Depends, Query, Request, Response

from app.api.schemas.base import Out
from app.api.schemas.stats_tables import RowOut, cell

CSV = "text/csv"


class TableFormat(StrEnum):
    """How a table is answered."""

    JSON = "json"
    CSV = "csv"


async def _wants_csv(
    request: Request,
    format: Annotated[  # noqa: A002 - the parameter's name in the query
        TableFormat | None, Query(description="`json` or `csv`; without it, as `Accept` says.")
    ] = None,
) -> bool:
    if format is not None:
        return format is TableFormat.CSV
    named = [part.partition(";")[0].strip().lower() for part in request.headers.get("accept", "").split(",")]
    return CSV in named and "application/json" not in named


WantsCsvDep = Annotated[bool, Depends(_wants_csv)]


def csv_answer(row_type: type[RowOut], schema: dict[str, Any] | None = None) -> dict[int | str, dict[str, Any]]:
    """Describe that a call answers CSV too, with which columns."""
    columns = ",".join(row_type.model_fields)
    return {
        200: {
            "content": {
                CSV: {"schema": schema or {"type": "string"}, "example": f"{columns}\r\n"},
            },
            "description": "JSON, or the rows as CSV with a header line.",
        }
    }


def answer(content: Out, rows: Sequence[RowOut], row_type: type[RowOut], name: str, *, as_csv: bool) -> Response:
    """Render a table; ``name`` is that of the file that a browser saves."""
    if not as_csv:
        return Response(content.model_dump_json(), media_type="application/json", headers={"Vary": "Accept"})
    text = io.StringIO()
    writer = csv.writer(text)
    columns = list(row_type.model_fields)
    writer.writerow(columns)
    writer.writerows([[_harmless(cell(getattr(row, column))) for column in columns] for row in rows])
    headers = {"Vary": "Accept", "Content-Disposition": f'attachment; filename="{name}.csv"'}
    return Response(text.getvalue(), media_type=CSV, headers=headers)


def _harmless(value: object) -> object:
    """Text that a spreadsheet would take for a formula is quoted: names and error texts are not all ours."""
    return f"'{value}" if isinstance(value, str) and value[:1] in "=+-@\t\r" and value else value
