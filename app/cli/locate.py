"""``isodyn locate``: one stretch of samples from a file."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from app.cli.common import DEFAULT_URL, Key, Url, connect, reported
from app.cli.fix_table import columns_of, print_fixes

if TYPE_CHECKING:
    import isodyn_client as isodyn

_CSV_COLUMNS = ("t_ms", "mx", "my", "mz", "ax", "ay", "az", "gx", "gy", "gz")


@reported
def locate(
    file: Annotated[Path, typer.Argument(help="Samples, .csv or .json.")],
    level: Annotated[str | None, typer.Option(help="Id of the level (lvl_...).", show_default=False)] = None,
    venue: Annotated[
        str | None, typer.Option(help="Id of the venue (ven_...), if the level is unknown.", show_default=False)
    ] = None,
    x: Annotated[
        float | None, typer.Option(help="Where it began on the level, plan metres; without x and y: anywhere.")
    ] = None,
    y: Annotated[float | None, typer.Option(help="Where it began, plan metres.")] = None,
    radius: Annotated[float, typer.Option(help="How far from (x, y) it may have begun, metres.")] = 3.0,
    heading: Annotated[
        float | None, typer.Option(help="Direction of the device's y axis, degrees counter-clockwise from +x.")
    ] = None,
    method: Annotated[
        str | None,
        typer.Option(
            help="Positioning method (GET /v1/methods); auto chooses one and says why.", show_default="the service's"
        ),
    ] = None,
    frame: Annotated[str, typer.Option(help="Sensor axes of a .csv: android, ios, frd or flu.")] = "android",
    output: Annotated[Path | None, typer.Option("--json", help="Write the fixes here, as columns.")] = None,
    url: Url = DEFAULT_URL,
    key: Key = None,
) -> None:
    """Locate one stretch of samples (at most 60 s), without a session; nothing is stored.

    .csv: columns t_ms (Unix ms), mx my mz (uT), ax ay az (m/s^2, gravity included), gx gy gz (rad/s), in any order.
    .json: the body of POST /v1/sessions/ID/segments: an object "samples" with t_ms and mag, acc, gyro of x, y, z, and
    whatever aids there are (wifi, ble, gnss, pressure, speed, steps).

    Example:  isodyn locate walk.csv --level lvl_... --x 12.5 --y 40

    Example:  isodyn locate walk.csv --venue ven_...
    """
    import isodyn_client as isodyn

    if (level is None) == (venue is None):
        raise typer.BadParameter("give --level, or --venue if the level is unknown")
    if (x is None) != (y is None):
        raise typer.BadParameter("give both --x and --y, or neither")
    samples, aids = read_samples(file, frame)
    prior = isodyn.Prior(x=x, y=y, radius_m=radius, heading_deg=heading)
    with connect(url, key) as client:
        result = client.locate(level, samples, venue_id=venue, method=method, prior=prior, aids=aids)
    fixes = result.fixes
    if result.method_reason:
        typer.echo(f"{result.method}: {result.method_reason}", err=True)
    if output:
        output.write_text(json.dumps(columns_of(fixes)))
    print_fixes(fixes, float(samples.t_ms[0]))


def read_samples(file: Path, frame: str) -> tuple[isodyn.Samples, isodyn.Aids]:
    """Samples of a .csv or .json file, and the aids of the latter."""
    from app.cli.errors import InputFileError

    readers = {".csv": _read_csv, ".json": _read_json}
    if file.suffix.lower() not in readers:
        raise InputFileError(file, "name a .csv or a .json file")
    try:
        return readers[file.suffix.lower()](file, frame)
    except (KeyError, TypeError, ValueError) as error:
        raise InputFileError(file, f"is not in the expected form ({error})") from error


def _read_csv(file: Path, frame: str) -> tuple[isodyn.Samples, isodyn.Aids]:
    import csv

    import isodyn_client as isodyn
    import numpy as np

    with file.open(newline="") as source:
        rows = list(csv.DictReader(source, skipinitialspace=True))
    missing = [name for name in _CSV_COLUMNS if not rows or name not in rows[0]]
    if missing:
        raise ValueError(f"lacks the columns {', '.join(missing)}")
    table = np.array([[float(row[name]) for name in _CSV_COLUMNS] for row in rows])
    return isodyn.Samples(table[:, 0], table[:, 1:4], table[:, 4:7], table[:, 7:10], frame), isodyn.Aids()


def _read_json(file: Path, frame: str) -> tuple[isodyn.Samples, isodyn.Aids]:
    import isodyn_client as isodyn
    import numpy as np

    body: dict[str, Any] = json.loads(file.read_text())
    samples = body.get("samples", body)

    def vectors(sensor: str) -> Any:
        return np.column_stack([samples[sensor][axis] for axis in "xyz"])

    axes = body.get("frame", frame)
    taken = isodyn.Samples(samples["t_ms"], vectors("mag"), vectors("acc"), vectors("gyro"), axes)
    return taken, isodyn.Aids.from_columns(body)
