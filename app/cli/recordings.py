"""``isodyn recording``: what phones pushed. ``isodyn markers``: the points that their annotations name."""

from __future__ import annotations

from datetime import UTC, datetime
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from app.cli.common import DEFAULT_URL, NAMED, Key, Url, connect, print_table, reported

if TYPE_CHECKING:
    from isodyn_client import Recording

app = typer.Typer(context_settings=NAMED, no_args_is_help=True, help="See what phones pushed, and mend it.")
markers = typer.Typer(
    context_settings=NAMED, no_args_is_help=True, help="Marked points of a level, which annotations of phones name."
)

RecordingId = Annotated[str, typer.Argument(help="Id of the recording (rec_...).")]


class State(StrEnum):
    """Where a recording stands."""

    OPEN = "open"
    CLOSED = "closed"
    WAITING = "waiting"


class For(StrEnum):
    """What recordings are for."""

    LOCATE = "locate"
    SURVEY = "survey"


@app.command("list")
@reported
def list_recordings(
    token: Annotated[str | None, typer.Option(help="Only of this token (igt_...).")] = None,
    device: Annotated[str | None, typer.Option(help="Only of this device (dev_...).")] = None,
    purpose: Annotated[For | None, typer.Option(help="Only for this purpose.")] = None,
    state: Annotated[State | None, typer.Option(help="Only in this state.")] = None,
    limit: Annotated[int, typer.Option(min=1, help="How many at most.")] = 50,
    url: Url = DEFAULT_URL,
    key: Key = None,
) -> None:
    """List recordings, newest first.

    Example:  isodyn recording list --state waiting
    """
    from itertools import islice

    with connect(url, key) as client:
        found = client.recordings(
            token_id=token, device_id=device, purpose=purpose and purpose.value, state=state and state.value
        )
        rows = [
            (
                one.id,
                f"{one.opened_at:%Y-%m-%d %H:%M:%S}",
                one.device_id,
                one.purpose,
                one.state,
                one.n_messages,
                one.session_id or " ".join(one.walk_ids),
                one.problem,
            )
            for one in islice(found, limit)
        ]
    columns = ("recording", "since (UTC)", "device", "for", "state", "messages", "became", "problem")
    print_table(columns, rows, empty="no recordings yet")


@app.command("show")
@reported
def show(recording_id: RecordingId, url: Url = DEFAULT_URL, key: Key = None) -> None:
    """Show one recording, with its annotations and what is wrong with it.

    Example:  isodyn recording show rec_...
    """
    with connect(url, key) as client:
        _print(client.recording(recording_id))


@app.command("close")
@reported
def close(recording_id: RecordingId, url: Url = DEFAULT_URL, key: Key = None) -> None:
    """End a recording now instead of after a silence: its session is closed, or survey walks are made of it.

    Example:  isodyn recording close rec_...
    """
    with connect(url, key) as client:
        _print(client.close_recording(recording_id))


@app.command("waypoints")
@reported
def waypoints(
    recording_id: RecordingId,
    file: Annotated[Path, typer.Argument(help="CSV with a header line: t_ms,x,y (Unix milliseconds, level metres).")],
    url: Url = DEFAULT_URL,
    key: Key = None,
) -> None:
    """Say where the phone was when: for a survey recording that is waiting, in place of its annotations.

    Example:  isodyn recording waypoints rec_... passed.csv
    """
    from app.cli.truth_files import read_truth

    rows = [row for part in read_truth(file) for row in zip(*(part[name] for name in ("t_ms", "x", "y")), strict=True)]
    t_ms, x, y = zip(*rows, strict=True)
    with connect(url, key) as client:
        _print(client.set_recording_waypoints(recording_id, t_ms, x, y))


def _print(one: Recording) -> None:
    told = {
        "state": one.state,
        "problem": one.problem or "none",
        "for": one.purpose,
        "device": one.device_id,
        "token": one.token_id,
        "level": one.level_id or f"any of {one.venue_id}",
        "session": one.session_id,
        "survey": one.survey_id,
        "walks": " ".join(one.walk_ids),
        "messages": f"{one.n_messages}, {one.n_late} of them too late for their turn",
        "samples": one.n_samples,
        "from": f"{one.opened_at:%Y-%m-%d %H:%M:%S} UTC",
        "to": f"{one.last_at:%Y-%m-%d %H:%M:%S} UTC",
    }
    print_table(("recording", one.id), [(name, value) for name, value in told.items() if value not in (None, "")])
    if one.annotations:
        typer.echo()
        rows = [
            (f"{datetime.fromtimestamp(note.t_ms / 1000.0, UTC):%H:%M:%S.%f}"[:-3], f"{note.t_ms:.0f}", note.text)
            for note in one.annotations
        ]
        print_table(("time (UTC)", "t_ms", "annotation"), rows)


@markers.command("show")
@reported
def show_markers(
    level_id: Annotated[str, typer.Argument(help="Id of the level (lvl_...).")], url: Url = DEFAULT_URL, key: Key = None
) -> None:
    """Print the markers of a level as CSV, the format that `set` takes.

    Example:  isodyn markers show lvl_... > doors.csv
    """
    import csv
    import sys

    with connect(url, key) as client:
        found = client.markers(level_id).markers
    out = csv.writer(sys.stdout, lineterminator="\n")
    out.writerows([("name", "x", "y"), *((one.name, f"{one.x:g}", f"{one.y:g}") for one in found)])


@markers.command("set")
@reported
def set_markers(
    file: Annotated[Path, typer.Argument(help="CSV with a header line: name,x,y (level metres).")],
    level_id: Annotated[str, typer.Argument(help="Id of the level (lvl_...).")],
    url: Url = DEFAULT_URL,
    key: Key = None,
) -> None:
    """Put the markers of a file in place of what the level had.

    Example:  isodyn markers set doors.csv lvl_...
    """
    from app.cli.errors import InputFileError
    from app.exchange.phones.errors import FormatError
    from app.exchange.phones.places import marker_rows

    try:
        rows = marker_rows(file.read_bytes())
    except FormatError as error:
        raise InputFileError(file, str(error)) from error
    with connect(url, key) as client:
        known = client.set_markers(level_id, rows).markers
    typer.echo(f"{len(known)} markers")
