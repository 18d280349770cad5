"""``isodyn session``: recordings located as sessions, and what can be done with sessions after the fact."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from app.cli.common import DEFAULT_URL, NAMED, Key, Url, connect, print_table, reported

if TYPE_CHECKING:
    import isodyn_client as isodyn

app = typer.Typer(
    context_settings=NAMED, no_args_is_help=True, help="Recordings as sessions, and sessions after the fact."
)


class RecordingFormat(StrEnum):
    """Who wrote a recording."""

    SENSOR_LOGGER = "sensor-logger"
    PHYPHOX = "phyphox"
    GETSENSORDATA = "getsensordata"


class PhoneSigns(StrEnum):
    """Signs of a phone's acceleration and gravity."""

    ANDROID = "android"
    IOS = "ios"


@app.command("replay")
@reported
def replay(
    session: Annotated[str, typer.Argument(help="Id of the session (ses_...).")],
    map_id: Annotated[
        list[str] | None,
        typer.Option("--map", help="Map version (map_...); may be repeated, one a level.", show_default="current maps"),
    ] = None,
    json_file: Annotated[Path | None, typer.Option("--json", help="Write fixes and comparison to a file.")] = None,
    url: Url = DEFAULT_URL,
    key: Key = None,
) -> None:
    """Locate a stored session once more on other map versions, and compare with what it was told then.

    Nothing is stored. On the maps of then the answer is that of then.

    Example:  isodyn session replay ses_... --map map_...
    """
    with connect(url, key) as client:
        found = client.replay(session, map_ids=map_id or None)
    maps, before = (", ".join(one.map_id for one in used) for used in (found.maps, found.maps_then))
    print_table(("session", found.session_id), [("maps then", before), ("maps now", maps)])
    typer.echo()
    print_table(("", "then", "now"), _told(found.comparison))
    typer.echo()
    typer.echo(_apart(found.comparison))
    if json_file is not None:
        _write(json_file, found)


@app.command("truth")
@reported
def truth(
    session: Annotated[str, typer.Argument(help="Id of the session (ses_...).")],
    file: Annotated[Path, typer.Argument(help="CSV file with columns t_ms, x, y and, if wanted, level_id, sd_m.")],
    url: Url = DEFAULT_URL,
    key: Key = None,
) -> None:
    """Say where a session was at some times, and show how far off its fixes were there.

    Times are Unix milliseconds on the clock of the samples, positions level metres. A fix counts if it lies within a
    second; points that none is near yet are compared when it comes.

    Example:  isodyn session truth ses_... marks.csv
    """
    from app.cli.truth_files import read_truth

    columns = read_truth(file)
    with connect(url, key) as client:
        points = [point for part in columns for point in client.add_ground_truth(session, **part).items]
    print_table(("t_ms", "x", "y", "error", "in 95 %", "sure", "status"), [_compared(point) for point in points])
    errors = [point.fix.error_m for point in points if point.fix is not None]
    if errors:
        inside = sum(point.fix.inside for point in points if point.fix is not None)
        typer.echo()
        typer.echo(
            f"{len(errors)} of {len(points)} points compared: error {_percentile(errors, 0.5):.2f} m (p50), "
            f"{_percentile(errors, 0.9):.2f} m (p90); {inside} inside the 95 % ellipse"
        )


def _compared(point: isodyn.TruthPoint) -> tuple[str, ...]:
    place = (f"{point.t_ms:.0f}", f"{point.x:.2f}", f"{point.y:.2f}")
    told = point.fix
    if told is None:
        return (*place, "-", "-", "-", "no fix within 1 s" if point.settled else "not yet")
    return (*place, f"{told.error_m:.2f} m", _yes(told.inside), _yes(told.sure), told.status)


def _yes(value: bool) -> str:
    return "yes" if value else "no"


def _percentile(values: list[float], share: float) -> float:
    ordered = sorted(values)
    return ordered[min(len(ordered) - 1, int(share * len(ordered)))]


def _told(comparison: isodyn.FixComparison) -> list[tuple[str, str, str]]:
    statuses = dict.fromkeys([*comparison.status_then, *comparison.status_now])
    shares = [(f"{one}", comparison.status_then.get(one, 0.0), comparison.status_now.get(one, 0.0)) for one in statuses]
    shares.append(("sure", comparison.sure_then, comparison.sure_now))
    counts = ("fixes", f"{comparison.n_then}", f"{comparison.n_now}")
    return [counts, *((name, f"{100 * then:.0f} %", f"{100 * now:.0f} %") for name, then, now in shares)]


def _apart(comparison: isodyn.FixComparison) -> str:
    """How far the fixes lie from those of then, in words."""
    if comparison.distance is None:
        return "no fix of then and now on one level at one time: nothing to compare"
    parts = []
    for name, distances in (("all", comparison.distance), ("sure both times", comparison.sure_distance)):
        if distances is not None:
            figures = f"{distances.p50:.2f} m (p50), {distances.p90:.2f} m (p90), {distances.largest:.2f} m (largest)"
            parts.append(f"apart, {name}, {distances.n} fixes: {figures}")
    if comparison.n_other_level:
        parts.append(f"on another level than then: {comparison.n_other_level} fixes")
    return "\n".join(parts)


def _write(file: Path, found: isodyn.Replay) -> None:
    import json

    columns = {name: getattr(found.fixes, name) for name in ("t_ms", "x", "y", "sure")}
    fixes = {name: column.tolist() for name, column in columns.items()}
    file.write_text(json.dumps({"fixes": fixes, "comparison": found.comparison.model_dump(mode="json")}))


@app.command("import")
@reported
def import_recording(
    file: Annotated[
        Path, typer.Argument(help="Recording: an export of Sensor Logger or phyphox, a GetSensorData log.")
    ],
    level: Annotated[str | None, typer.Option(help="Id of the level (lvl_...).", show_default=False)] = None,
    venue: Annotated[
        str | None, typer.Option(help="Id of the venue (ven_...), if the level is unknown.", show_default=False)
    ] = None,
    format: Annotated[  # noqa: A002
        RecordingFormat | None, typer.Option(help="Of the file.", show_default="what is in it tells")
    ] = None,
    frame: Annotated[
        PhoneSigns, typer.Option(help="Signs of acceleration and gravity, if the file does not tell the platform.")
    ] = PhoneSigns.ANDROID,
    x: Annotated[float | None, typer.Option(help="Where it began, plan metres; without x and y: anywhere.")] = None,
    y: Annotated[float | None, typer.Option(help="Where it began, plan metres.")] = None,
    radius: Annotated[float, typer.Option(min=0.1, help="How far from (x, y) it may have begun, metres.")] = 3.0,
    heading: Annotated[
        float | None, typer.Option(help="Direction of the device's y axis, degrees counter-clockwise from +x.")
    ] = None,
    method: Annotated[str | None, typer.Option(help="Positioning method.", show_default="the service's")] = None,
    device: Annotated[str | None, typer.Option(help="Id of the device (dev_...), to use what is known of it.")] = None,
    start: Annotated[
        str | None, typer.Option(help="When a recording without a date began, as in 2026-11-22T09:30:00Z.")
    ] = None,
    segment: Annotated[float, typer.Option(min=1.0, max=60.0, help="Length of the segments, seconds.")] = 5.0,
    radio: Annotated[bool, typer.Option(help="With the Wi-Fi and Bluetooth readings of a GetSensorData log.")] = False,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Read and report only; open no session.")] = False,
    output: Annotated[Path | None, typer.Option("--json", help="Write the fixes here, as columns.")] = None,
    url: Url = DEFAULT_URL,
    key: Key = None,
) -> None:
    """Locate a recording of a phone: open a session, send the file as segments, print the positions.

    Says on stderr what was read, what was assumed, what was left out, and the session's id, which replay and the
    trajectory take.

    Example:  isodyn session import recording.zip --level lvl_... --x 12.5 --y 40

    Example:  isodyn session import log.txt --venue ven_... --format getsensordata --radio
    """
    from app.cli.session_files import Place, import_session
    from app.cli.survey_files import start_of
    from app.exchange.phones import PhoneFrame
    from app.exchange.phones.files import FileChoices, PhoneFormat

    if (level is None) == (venue is None):
        raise typer.BadParameter("give --level, or --venue if the level is unknown")
    if (x is None) != (y is None):
        raise typer.BadParameter("give both --x and --y, or neither")
    choices = FileChoices(PhoneFrame(frame.value), None if start is None else start_of(start), radio)
    kind = PhoneFormat(format.value) if format else None
    place = Place(level, venue, x, y, radius, heading, method, device)
    with connect(url, key) as client:
        import_session(client, file, kind, choices, place, segment_s=segment, dry_run=dry_run, output=output)
