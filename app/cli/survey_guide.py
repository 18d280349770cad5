"""``isodyn survey start`` and ``watch``: from a picture of the floor to a phone that surveys, and how the map grows."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from app.cli.common import DEFAULT_URL, Key, Url, connect, reported
from app.cli.devices import Signs

if TYPE_CHECKING:
    from isodyn_client import Client, Level, NewIngestToken

_PNG = b"\x89PNG\r\n\x1a\n"
_SHOWN_STRETCHES = 3


@reported
def start(
    plan: Annotated[Path, typer.Option(help="Picture of the floor, PNG, y up.")],
    venue: Annotated[str, typer.Option(help="Name of a new venue, or the id (ven_...) of one.")],
    level: Annotated[str, typer.Option(help="Name of the new level, such as F2.")],
    scale: Annotated[float | None, typer.Option(min=1e-4, help="Metres that a pixel of the picture covers.")] = None,
    width: Annotated[float | None, typer.Option(min=1.0, help="Or: width of the picture, m.")] = None,
    ordinal: Annotated[int, typer.Option(help="Storey: 0 is the ground floor.")] = 0,
    markers: Annotated[Path | None, typer.Option(help="Marked points, CSV with a header line: name,x,y (m).")] = None,
    phone: Annotated[str, typer.Option(help="Name of the phone that surveys.")] = "phone",
    frame: Annotated[
        Signs, typer.Option(help="Signs of its accelerometer: ios for an iPhone, unless the app standardises it.")
    ] = Signs.ANDROID,
    phone_url: Annotated[
        str | None,
        typer.Option(help="Address of the service as the phone reaches it.", show_default="that of --url"),
    ] = None,
    qr: Annotated[bool, typer.Option("--qr/--no-qr", help="Show the phone's address as a QR code, too.")] = True,
    url: Url = DEFAULT_URL,
    key: Key = None,
) -> None:
    """Make venue, level, markers and a phone's address, and say what to do next.

    Walks that the phone sends become drafts of the map, which you publish when they are good enough.
    docs/tutorial-survey.md shows the same in the dashboard.

    Example:  isodyn survey start --plan plan.png --scale 0.05 --venue Warehouse --level F0 --markers doors.csv
    """
    from app.cli.pairing import address_for_phone, reach_hint

    extent = _extent(plan, scale, width)
    points = _points(markers)
    with connect(url, key) as client:
        made = _level(client, plan, extent, venue=venue, name=level, ordinal=ordinal)
        if points:
            client.set_markers(made.id, points)
        device = client.create_device(phone)
        token = client.create_ingest_token(
            phone, device.id, level_id=made.id, purpose="survey", frame=frame.value, build="draft"
        )
    reached_at = phone_url or url
    typer.echo(f"level {made.id}: {extent[2]:g} x {extent[3]:g} m, {len(points)} markers")
    _tell(token, made, address_for_phone(token.url, reached_at), qr=qr)
    if hint := reach_hint(reached_at):
        typer.secho(hint, fg=typer.colors.YELLOW, err=True)


@reported
def watch(
    level_id: Annotated[str, typer.Argument(help="Id of the level (lvl_...).")],
    every: Annotated[float, typer.Option(min=0.5, help="How often to look, s.")] = 5.0,
    once: Annotated[bool, typer.Option("--once", help="Say how it stands, and end.")] = False,
    url: Url = DEFAULT_URL,
    key: Key = None,
) -> None:
    """Follow a survey: recordings as they come, and what each new version of the map covers; until Ctrl-C.

    Coverage is the mapped share of the walkable ground, the error what the map lets a phone hope for.

    Example:  isodyn survey watch lvl_...
    """
    import time

    known: set[str] = set()
    with connect(url, key) as client:
        client.level(level_id)
        while True:
            for line in _state(client, level_id):
                if line not in known:
                    typer.echo(line)
                    known.add(line)
            if once:
                return
            time.sleep(every)


def _extent(plan: Path, scale: float | None, width: float | None) -> tuple[float, float, float, float]:
    """The rectangle in metres that the picture covers; its origin is the lower left corner."""
    from app.cli.errors import InputFileError

    if (scale is None) == (width is None):
        raise typer.BadParameter("give one of --scale (metres a pixel) and --width (metres)")
    head = plan.read_bytes()[:24]
    if len(head) < 24 or not head.startswith(_PNG):
        raise InputFileError(plan, "is not a PNG picture; export the plan as PNG")
    columns, rows = struct.unpack(">II", head[16:24])
    per_pixel = scale if scale is not None else (width or 0.0) / columns
    return 0.0, 0.0, round(columns * per_pixel, 3), round(rows * per_pixel, 3)


def _points(markers: Path | None) -> list[tuple[str, float, float]]:
    from app.cli.errors import InputFileError
    from app.exchange.phones.errors import FormatError
    from app.exchange.phones.places import marker_rows

    if markers is None:
        return []
    try:
        return marker_rows(markers.read_bytes())
    except FormatError as error:
        raise InputFileError(markers, str(error)) from error


def _level(
    client: Client, plan: Path, extent: tuple[float, float, float, float], *, venue: str, name: str, ordinal: int
) -> Level:
    venue_id = venue if venue.startswith("ven_") else client.create_venue(venue).id
    level = client.create_level(venue_id, name, ordinal=ordinal, extent=extent)
    client.set_plan_image(level.id, plan.read_bytes())
    return level


def _tell(token: NewIngestToken, level: Level, address: str, *, qr: bool) -> None:
    from app.cli.pairing import qr_code

    typer.echo(address)
    if qr:
        typer.echo(qr_code(address))
    steps = [
        *token.settings,
        "Record, walk from marker to marker in straight lines, and annotate each with its name as you pass it",
        f"Watch the map grow: isodyn survey watch {level.id}",
        "Publish it when it is good enough: isodyn map publish map_...",
    ]
    for number, line in enumerate(steps, start=1):
        typer.echo(f"{number}. {line}")


def _state(client: Client, level_id: str) -> Iterator[str]:
    """Lines about recordings, oldest first, then about the newest map and what it lacks."""
    recordings = [one for one in client.recordings(purpose="survey") if one.level_id == level_id]
    for one in reversed(recordings):
        marks = f"{len(one.annotations)} annotations"
        became = f", {len(one.walk_ids)} walks" if one.walk_ids else ""
        # while it is open it grows with every message: said once
        grown = "" if one.state == "open" else f", {one.n_samples} samples, {marks}"
        yield f"recording {one.id} {one.state}{grown}{became}" + (f": {one.problem}" if one.problem else "")
    newest = next(iter(client.maps(level_id=level_id)), None)
    if newest is None:
        yield "no map yet: it is built when the first walk has ended"
        return
    quality = client.map_quality(newest.id)
    error = quality.mean_error
    hoped = "" if error.p50_m is None else f", expected error {error.p50_m:.1f} m (90 %: {error.p90_m:.1f} m)"
    yield (
        f"map {newest.id} version {newest.version}: {newest.n_walks} walks, {newest.mapped_area_m2:.0f} m2 mapped, "
        f"{100 * quality.coverage.mapped_share:.0f} % covered{hoped}"
    )
    for line in client.survey_suggestions(newest.id, count=_SHOWN_STRETCHES).suggestions:
        (ax, ay), (bx, by) = line.start, line.end
        yield f"  walk next: {ax:.0f},{ay:.0f} to {bx:.0f},{by:.0f} ({line.words})"
