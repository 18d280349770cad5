"""Geofence events as a table: one line an event, the columns of the JSON object."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable

from fastapi import Request

from app.api.schemas.geofences import EVENT_EXAMPLE
from app.services.geofence_records import GeofenceEvent
from app.services.geofencing import event_data

CSV = "text/csv"
COLUMNS = tuple(EVENT_EXAMPLE)


def wants_csv(request: Request) -> bool:
    """Whether a table is preferred: named, and not behind JSON."""
    ranks: dict[str, float] = {}
    for item in request.headers.get("accept", "").split(","):
        name, _, parameters = item.partition(";")
        key, _, value = parameters.strip().partition("=")
        weighted = key.strip() == "q" and value.strip().replace(".", "", 1).isdigit()
        ranks[name.strip().lower()] = float(value) if weighted else 1.0
    table = ranks.get(CSV, 0.0)
    return table > 0 and table >= ranks.get("application/json", 0.0)


def events_csv(events: Iterable[GeofenceEvent]) -> bytes:
    """Events as CSV (RFC 4180) with a line of names; what is not known is empty."""
    out = io.StringIO()
    writer = csv.writer(out)
    writer.writerow(COLUMNS)
    for event in events:
        values = event_data(event)
        writer.writerow([_cell(values[name]) for name in COLUMNS])
    return out.getvalue().encode()


def _cell(value: object) -> object:
    # a name that begins like a formula would be one to a spreadsheet
    if isinstance(value, str) and value.startswith(("=", "+", "-", "@", "\t", "\r")):
        return f"'{value}"
    return "" if value is None else value
