"""``isodyn geofence``: areas of levels, and who entered or left them."""

from __future__ import annotations

from datetime import UTC, datetime
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from app.cli.common import DEFAULT_URL, NAMED, Key, Url, connect, print_table, reported

app = typer.Typer(
    context_settings=NAMED, no_args_is_help=True, help="Draw areas on levels; see who entered and left them."
)


class Kind(StrEnum):
    """What is told of a geofence."""

    ENTER = "enter"
    LEAVE = "leave"
    DWELL = "dwell"


OfLevel = Annotated[str | None, typer.Option(help="Only of this level.")]
_TIMES = ["%Y-%m-%d", "%Y-%m-%dT%H:%M:%S", "%Y-%m-%d %H:%M:%S"]


@app.command("create")
@reported
def create(
    level_id: Annotated[str, typer.Argument(help="Level (lvl_...).")],
    name: Annotated[str, typer.Argument(help="Name of the area.")],
    polygon: Annotated[str, typer.Option(help='Corners in level metres: "x,y x,y x,y ...".')],
    event: Annotated[
        list[Kind] | None,
        typer.Option(help="What is told: enter, leave, dwell. May be repeated.", show_default="enter, leave"),
    ] = None,
    dwell: Annotated[float | None, typer.Option(help="Seconds after which a stay is told as dwell.")] = None,
    confidence: Annotated[float, typer.Option(help="Probability of being inside at which it is entered.")] = 0.9,
    url: Url = DEFAULT_URL,
    key: Key = None,
) -> None:
    """Draw an area on a level and print its id.

    Example:  isodyn geofence create lvl_... "Gate 4" --polygon "10,4 16,4 16,9" --event dwell --dwell 60
    """
    corners = _corners(polygon)
    events = None if event is None else [one.value for one in event]
    with connect(url, key) as client:
        made = client.create_geofence(level_id, name, corners, events=events, dwell_s=dwell, confidence=confidence)
    typer.echo(made.id)


@app.command("list")
@reported
def list_geofences(level: OfLevel = None, url: Url = DEFAULT_URL, key: Key = None) -> None:
    """List geofences, newest first.

    Example:  isodyn geofence list --level lvl_...
    """
    with connect(url, key) as client:
        rows = [
            (
                one.id,
                one.name,
                one.level_id,
                " ".join(one.events),
                "" if one.dwell_s is None else f"{one.dwell_s:g}",
                f"{one.confidence:g}",
                " ".join(f"{x:g},{y:g}" for x, y in one.polygon),
            )
            for one in client.geofences(level_id=level)
        ]
    columns = ("geofence", "name", "level", "tells", "dwell (s)", "confidence", "polygon (m)")
    print_table(columns, rows, empty="no geofences yet")


@app.command("delete")
@reported
def delete(
    geofence_id: Annotated[str, typer.Argument(help="Id of the geofence (gfc_...).")],
    url: Url = DEFAULT_URL,
    key: Key = None,
) -> None:
    """Delete a geofence; its events are kept.

    Example:  isodyn geofence delete gfc_...
    """
    with connect(url, key) as client:
        client.delete_geofence(geofence_id)
    typer.echo(f"{geofence_id} is deleted")


@app.command("events")
@reported
def events(
    level: OfLevel = None,
    geofence: Annotated[str | None, typer.Option(help="Only of this geofence.")] = None,
    session: Annotated[str | None, typer.Option(help="Only of this session.")] = None,
    kind: Annotated[Kind | None, typer.Option(help="Only of this kind.")] = None,
    after: Annotated[datetime | None, typer.Option(formats=_TIMES, help="Only after this time (UTC).")] = None,
    before: Annotated[datetime | None, typer.Option(formats=_TIMES, help="Only before this time (UTC).")] = None,
    limit: Annotated[int, typer.Option(min=1, help="How many at most.")] = 100,
    csv: Annotated[Path | None, typer.Option(help="Write the newest 500 into this CSV file instead.")] = None,
    url: Url = DEFAULT_URL,
    key: Key = None,
) -> None:
    """List who entered, left or dwelt in geofences, newest first; times are those of the positions.

    Example:  isodyn geofence events --level lvl_... --kind enter --after 2026-11-22
    """
    from itertools import islice

    wanted: dict[str, Any] = {
        "level_id": level,
        "geofence_id": geofence,
        "session_id": session,
        "kind": kind and kind.value,
        "after": after and after.replace(tzinfo=UTC),
        "before": before and before.replace(tzinfo=UTC),
    }
    with connect(url, key) as client:
        if csv is not None:
            csv.write_bytes(client.geofence_events_csv(**wanted))
            return
        rows = [
            (
                f"{datetime.fromtimestamp(one.t_ms / 1000.0, UTC):%Y-%m-%d %H:%M:%S}",
                one.kind.value,
                one.geofence_name,
                one.session_id,
                "" if one.x is None or one.y is None else f"{one.x:.1f}, {one.y:.1f}",
                "" if one.probability is None else f"{one.probability:.3f}",
                "" if one.dwell_s is None else f"{one.dwell_s:.0f}",
                one.reason or "",
            )
            for one in islice(client.geofence_events(**wanted), limit)
        ]
    columns = ("time (UTC)", "event", "geofence", "session", "at (m)", "inside", "stay (s)", "")
    print_table(columns, rows, empty="no events")


def _corners(polygon: str) -> list[tuple[float, float]]:
    try:
        return [(float(x), float(y)) for x, y in (corner.split(",") for corner in polygon.split())]
    except ValueError as error:
        raise typer.BadParameter('needs corners as "x,y x,y x,y"', param_hint="--polygon") from error
