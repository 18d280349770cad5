"""``isodyn map import``, ``isodyn survey export`` and ``isodyn survey import``: files of others, in and out."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from app.cli.common import DEFAULT_URL, FAILED, Key, Url, connect, progress_bars, reported
from app.cli.maps import MapFormat
from app.cli.surveys import Split

if TYPE_CHECKING:
    from app.cli.survey_files import Importer


class Channel(StrEnum):
    """What a layer is of the field."""

    X = "x"
    Y = "y"
    Z = "z"
    H = "h"
    V = "v"
    TOTAL = "total"


class FieldUnit(StrEnum):
    """Unit of a map's field."""

    MICROTESLA = "uT"
    NANOTESLA = "nT"


class SurveyFormat(StrEnum):
    """What recordings are."""

    CSV = "csv"
    GETSENSORDATA = "getsensordata"
    SENSOR_LOGGER = "sensor-logger"
    PHYPHOX = "phyphox"
    DATASET = "dataset"
    ISODYN = "isodyn"


PHONE_FORMATS = frozenset({SurveyFormat.SENSOR_LOGGER.value, SurveyFormat.PHYPHOX.value})


class Frame(StrEnum):
    """Axes of the sensors."""

    ANDROID = "android"
    IOS = "ios"
    FRD = "frd"
    FLU = "flu"


@reported
def import_map(
    level: Annotated[str, typer.Argument(help="Id of the level (lvl_...).")],
    file: Annotated[Path, typer.Argument(help="The file: an even grid in metres of the level's plan.")],
    format: Annotated[  # noqa: A002
        MapFormat | None, typer.Option(help="Of the file; without it, what its name says.")
    ] = None,
    channel: Annotated[
        Channel | None, typer.Option(help="What the only layer of the file is, if its name does not tell.")
    ] = None,
    unit: Annotated[FieldUnit | None, typer.Option(help="Of the field, if the file does not tell.")] = None,
    sd: Annotated[float | None, typer.Option(help="Standard deviation, uT, if the file has none.")] = None,
    title: Annotated[str | None, typer.Option(help="Kept with the map.")] = None,
    licence: Annotated[str | None, typer.Option(help="Licence of the data; kept with the map.")] = None,
    attribution: Annotated[str | None, typer.Option(help="Whom to name; kept with the map.")] = None,
    draft: Annotated[bool, typer.Option("--draft", help="Only store it; the level's current map stays.")] = False,
    url: Url = DEFAULT_URL,
    key: Key = None,
) -> None:
    """Store the map of a file as the level's next version; print its id.

    netCDF (classic), GeoTIFF, ESRI ASCII grids and XYZ are read; several layers go into a zip file. What the file
    does not tell is assumed, and said.

    Example:  isodyn map import lvl_... hall.nc
    Example:  isodyn map import lvl_... total.asc --channel total --unit nT --sd 1.5
    """
    from app.cli.survey_files import guess_map_format

    kind = format.value if format else guess_map_format(file)
    with connect(url, key) as client:
        info = client.import_map(
            level,
            file.read_bytes(),
            format=kind,
            channel=channel and channel.value,
            unit=unit and unit.value,
            sd=sd,
            title=title,
            licence=licence,
            attribution=attribution,
            publish=not draft,
        )
    for words in info.origin.assumed if info.origin else ():
        typer.echo(words, err=True)
    typer.echo(info.id)


@reported
def export_survey(
    survey: Annotated[str, typer.Argument(help="Id of the survey (srv_...).")],
    output: Annotated[
        Path, typer.Option("--output", "-o", help="Where to write: a .zip file, or a folder to unpack into.")
    ],
    radio: Annotated[
        bool, typer.Option(help="With Wi-Fi and Bluetooth readings. Their addresses identify access points and phones.")
    ] = False,
    url: Url = DEFAULT_URL,
    key: Key = None,
) -> None:
    """Write all walks of a survey to a zip file or a folder, from which `isodyn survey import` reads them again.

    Ids of devices stay behind, and so does what is known about devices.

    Example:  isodyn survey export srv_... -o spring.zip
    """
    from app.cli.survey_files import unpack

    with connect(url, key) as client:
        content = client.export_survey(survey, radio=radio)
    if output.suffix.lower() == ".zip":
        output.write_bytes(content)
    else:
        unpack(content, output)
    typer.echo(f"{output}: {len(content)} bytes")


@reported
def import_survey(
    target: Annotated[str, typer.Argument(help="Id of a level (lvl_...) or of a survey (srv_...) of one.")],
    files: Annotated[list[Path], typer.Argument(help="Files (or folders, of data sets).")],
    format: Annotated[  # noqa: A002
        SurveyFormat,
        typer.Option(
            help="csv: a row a sample; getsensordata: logs of that Android application; sensor-logger, "
            "phyphox: exports of these applications; dataset: folders as docs/exchange.md describes; "
            "isodyn: what `isodyn survey export` writes."
        ),
    ],
    name: Annotated[str, typer.Option(help="Name of the survey on the level; made if there is none.")] = "imported",
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Read and report only; upload nothing.")] = False,
    floor: Annotated[str | None, typer.Option(help="Only what lies on this floor, as the file calls it.")] = None,
    column: Annotated[
        list[str] | None, typer.Option(help="csv: a column by its header, as in mag_x=MagX; may be repeated.")
    ] = None,
    unit: Annotated[
        list[str] | None, typer.Option(help="csv: a unit, as in mag=nT, acc=g, gyro=deg/s, t=ms; may be repeated.")
    ] = None,
    frame: Annotated[
        Frame,
        typer.Option(
            help="csv: axes of the sensors; docs/api.md says what they are. sensor-logger, phyphox: android or ios, "
            "if the file does not tell."
        ),
    ] = Frame.ANDROID,
    markers: Annotated[
        Path | None,
        typer.Option(help="sensor-logger: named places, a CSV file with name,x,y: annotations of these names count."),
    ] = None,
    start: Annotated[
        str | None, typer.Option(help="When recordings without a date began, as in 2026-11-22T09:30:00Z.")
    ] = None,
    anchor: Annotated[
        str | None,
        typer.Option(
            metavar="LAT,LON[,BEARING]",
            help="Where the plan's origin lies, and the bearing of its y axis; without it, the venue's anchor.",
        ),
    ] = None,
    radio: Annotated[bool, typer.Option(help="With Wi-Fi and Bluetooth readings: their addresses.")] = False,
    split: Annotated[Split, typer.Option(help="dataset: which walks of the folder.")] = Split.TRAIN,
    url: Url = DEFAULT_URL,
    key: Key = None,
) -> None:
    """Upload recordings in others' formats as survey walks; print the survey's id.

    Says of each file what was read, what was assumed, and what was left out and why. Importing a file again uploads
    nothing twice.

    Example:  isodyn survey import lvl_... walk1.csv walk2.csv --format csv --dry-run
    Example:  isodyn survey import lvl_... log.txt --format getsensordata --floor 2
    Example:  isodyn survey import lvl_... recording.zip --format sensor-logger --markers doors.csv
    Example:  isodyn survey import srv_... spring.zip --format isodyn
    """
    from app.cli.survey_files import Choices, Importer, anchor_of, pairs_of, start_of

    choices = Choices(
        format=format.value,
        columns=pairs_of("column", column or ()),
        units=pairs_of("unit", unit or ()),
        floor=floor,
        start_s=None if start is None else start_of(start),
        radio=radio,
        split=split.name_in_data,
        markers=markers,
    )
    if format.value in PHONE_FORMATS and frame not in {Frame.ANDROID, Frame.IOS}:
        raise typer.BadParameter("phones tell android or ios", param_hint="--frame")
    with connect(url, key) as client:
        importer = Importer(client, target, choices, name, frame=frame.value, dry_run=dry_run)
        importer.plane = importer.plane if anchor is None else anchor_of(anchor)
        _import_files(importer, files)
    for line in importer.lines:
        typer.echo(line, err=not dry_run)
    if not dry_run and importer.survey_id is not None:
        typer.echo(importer.survey_id)
    if importer.failed:
        raise typer.Exit(FAILED)


def _import_files(importer: Importer, files: list[Path]) -> None:
    with progress_bars() as bars:
        bar = bars.add_task("importing", total=len(files), text="")
        for number, file in enumerate(files, start=1):
            bars.update(bar, text=f"{file.name} ({number} of {len(files)})")
            importer.take(file)
            bars.update(bar, advance=1)
