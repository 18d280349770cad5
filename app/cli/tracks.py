"""``isodyn session export``: the track of a session as a file."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from app.cli.common import DEFAULT_URL, Key, Url, connect, reported


class TrackFormat(StrEnum):
    """How a track is written; a test compares this with the service's formats, which take long to import."""

    GEOJSON = "geojson"
    MF_JSON = "mf-json"
    GPX = "gpx"
    CSV = "csv"


class TrackKind(StrEnum):
    """Which fixes are written."""

    FILTERED = "filtered"
    FIXED_LAG = "fixed_lag"
    SMOOTHED = "smoothed"


@reported
def export(
    session: Annotated[str, typer.Argument(help="Id of the session (ses_...).")],
    output: Annotated[Path, typer.Option("--output", "-o", help="File to write.")],
    format: Annotated[  # noqa: A002
        TrackFormat, typer.Option(help="CSV works without an anchor of the venue.")
    ] = TrackFormat.GEOJSON,
    kind: Annotated[
        TrackKind, typer.Option(help="As told in the moment, about 5 s later, or from the whole session.")
    ] = TrackKind.FILTERED,
    url: Url = DEFAULT_URL,
    key: Key = None,
) -> None:
    """Write the track of a session to a file, for maps, spreadsheets and other programs.

    Lines run only through fixes that claim a position; where one is ambiguous, off the map or missing, they break.

    Example:  isodyn session export ses_... --format gpx -o walk.gpx
    """
    with connect(url, key) as client:
        content = client.track(session, format=format.value, kind=kind.value)
    output.write_bytes(content)
    typer.echo(f"{output}: {len(content)} bytes", err=True)
