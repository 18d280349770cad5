"""``isodyn survey``: places, and walks with known positions."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from app.cli.common import DEFAULT_URL, NAMED, Key, Url, connect, print_table, progress_bars, reported

if TYPE_CHECKING:
    from isodyn_client import Client

app = typer.Typer(
    context_settings=NAMED, no_args_is_help=True, help="Create levels, upload survey walks, list what is there."
)


class Split(StrEnum):
    """Which walks of a data-set folder."""

    TRAIN = "train"
    TEST = "test"
    ALL = "all"

    @property
    def name_in_data(self) -> Literal["train", "test"] | None:
        """As the reader takes it; None for all."""
        return None if self is Split.ALL else "train" if self is Split.TRAIN else "test"


@app.command("level")
@reported
def create_level(
    folder: Annotated[
        Path | None,
        typer.Argument(help="Folder with floor.json (width_m, height_m), floor_image.png, geojson_map.json."),
    ] = None,
    venue: Annotated[str | None, typer.Option(help="Name of a new venue, or the id (ven_...) of one.")] = None,
    name: Annotated[str | None, typer.Option(help="Name of the level, such as F2.")] = None,
    ordinal: Annotated[int | None, typer.Option(help="Storey: 0 is the ground floor, -1 below it.")] = None,
    extent: Annotated[
        tuple[float, float, float, float] | None,
        typer.Option(help="x_min y_min x_max y_max of the plan, metres.", metavar="X0 Y0 X1 Y1"),
    ] = None,
    plan: Annotated[Path | None, typer.Option(help="Plan image, PNG, stretched over the extent.")] = None,
    vector_plan: Annotated[Path | None, typer.Option(help="Vector plan, GeoJSON in level metres.")] = None,
    url: Url = DEFAULT_URL,
    key: Key = None,
) -> None:
    """Create a level (and its venue), from a folder or from options; print the level's id.

    Options win over what the folder says.

    Example:  isodyn survey level maps/samples/ilc20/site1-F2
    Example:  isodyn survey level --venue "Central Mall" --name F1 --ordinal 0 --extent 0 0 120.5 80 --plan f1.png
    """
    from app.cli.uploads import level_upload, open_level

    known = level_upload(open_level(folder)) if folder else None
    venue = venue or (known.site if known else None)
    name = name or (known.name if known else None)
    extent = extent or (known.extent if known else None)
    if not (venue and name and extent):
        raise typer.BadParameter("give a FOLDER, or --venue, --name and --extent")
    image = plan.read_bytes() if plan else (known.plan_png if known else None)
    storey = ordinal if ordinal is not None else (known.ordinal if known else 0)
    with connect(url, key) as client:
        venue_id = venue if venue.startswith("ven_") else client.create_venue(venue).id
        level = client.create_level(venue_id, name, ordinal=storey, extent=extent)
        if image:
            client.set_plan_image(level.id, image)
        if vector_plan:
            client.set_vector_plan(level.id, vector_plan.read_bytes())
        elif known and known.vector_plan:
            import json

            client.set_vector_plan(level.id, json.dumps(known.vector_plan).encode())
    typer.echo(level.id)


@app.command("upload")
@reported
def upload(
    level: Annotated[str, typer.Argument(help="Id of the level (lvl_...).")],
    folder: Annotated[Path, typer.Argument(help="Data-set folder of the level (traces.parquet, imu.parquet, ...).")],
    split: Annotated[Split, typer.Option(help="Which walks of the folder.")] = Split.TRAIN,
    walk: Annotated[
        list[str] | None, typer.Option(help="Only walks whose id starts like this; may be repeated.")
    ] = None,
    name: Annotated[str, typer.Option(help="Name of the new survey.")] = "survey",
    wifi: Annotated[bool, typer.Option(help="Send the Wi-Fi readings as well.")] = True,
    url: Url = DEFAULT_URL,
    key: Key = None,
) -> None:
    """Upload survey walks of a data-set folder into a new survey; print the survey's id.

    Samples: 50 Hz or so of magnetometer (uT), accelerometer (m/s^2, with gravity) and gyroscope (rad/s), and waypoints
    in plan metres. docs/surveying.md says how to walk a survey.

    Example:  isodyn survey upload lvl_... maps/samples/ilc20/site1-F2
    """
    from dataclasses import replace

    from app.cli.transport import add_walk
    from app.cli.uploads import choose_walks, open_level

    walks = choose_walks(open_level(folder), split.name_in_data, walk or (), None)
    with connect(url, key) as client, progress_bars() as bars:
        survey = client.create_survey(level, name)
        bar = bars.add_task("uploading walks", total=len(walks), text="")
        for number, recorded in enumerate(walks, start=1):
            data = recorded.survey_walk()
            add_walk(client, survey.id, data if wifi else replace(data, wifi=None))
            bars.update(bar, advance=1, text=f"{number} of {len(walks)}")
    typer.echo(survey.id)


@app.command("list")
@reported
def list_surveys(
    level: Annotated[str | None, typer.Option(help="Only surveys of this level.")] = None,
    url: Url = DEFAULT_URL,
    key: Key = None,
) -> None:
    """List surveys.

    Example:  isodyn survey list --level lvl_...
    """
    with connect(url, key) as client:
        rows = [
            (s.id, s.level_id, s.name, s.n_walks, f"{s.created_at:%Y-%m-%d %H:%M}")
            for s in client.surveys(level_id=level)
        ]
    print_table(("survey", "level", "name", "walks", "created (UTC)"), rows, empty="no surveys yet")


@app.command("levels")
@reported
def list_levels(
    venue: Annotated[str | None, typer.Option(help="Only levels of this venue.")] = None,
    near: Annotated[
        str | None, typer.Option(help="Only levels near LATITUDE,LONGITUDE (degrees), nearest first.")
    ] = None,
    radius: Annotated[float | None, typer.Option(help="How near, metres.", show_default="1000")] = None,
    name: Annotated[str | None, typer.Option(help="Only levels with these words in their or their venue's name.")] = (
        None
    ),
    storey: Annotated[int | None, typer.Option(help="Only levels of this height order; 0 is the ground floor.")] = None,
    url: Url = DEFAULT_URL,
    key: Key = None,
) -> None:
    """List levels with the id of the map that new sessions use.

    Venues without an anchor, and their levels, are not found by place.

    Example:  isodyn survey levels --near 48.1507,11.5691 --radius 500
    """
    place = None if near is None else _place(near)
    with connect(url, key) as client:
        names: dict[str, str] = {}
        rows = [
            (
                one.id,
                f"{_venue_name(client, one.venue_id, names)} / {one.name}",
                one.ordinal,
                f"{one.extent.x_max - one.extent.x_min:.0f} x {one.extent.y_max - one.extent.y_min:.0f} m",
                one.current_map_id or "no map yet",
            )
            for one in client.levels(venue_id=venue, near=place, radius_m=radius, q=name, ordinal=storey)
        ]
    print_table(("level", "venue / level", "storey", "extent", "map"), rows, empty="no levels yet")


def _place(text: str) -> tuple[float, float]:
    try:
        latitude, longitude = map(float, text.split(","))
    except ValueError as error:
        raise typer.BadParameter("give LATITUDE,LONGITUDE in degrees", param_hint="--near") from error
    return latitude, longitude


def _venue_name(client: Client, venue_id: str, names: dict[str, str]) -> str:
    if venue_id not in names:
        names[venue_id] = client.venue(venue_id).name
    return names[venue_id]
