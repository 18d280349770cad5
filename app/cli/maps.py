"""``isodyn map``: build, look at and export maps."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from app.cli.common import DEFAULT_URL, NAMED, Key, Url, connect, print_table, progress_bars, reported

if TYPE_CHECKING:
    import isodyn_client as isodyn

app = typer.Typer(context_settings=NAMED, no_args_is_help=True, help="Build magnetic maps, list, show and export them.")


class Features(StrEnum):
    """What of the field the map holds."""

    VECTOR = "vector"
    HV = "hv"
    TOTAL = "total"


class Statistic(StrEnum):
    """What is exported of a channel."""

    MEAN = "mean"
    SD = "sd"
    SUPPORT = "support"


class MapFormat(StrEnum):
    """Files that other programs read; docs/exchange.md says what is in them."""

    NETCDF = "netcdf"
    GEOTIFF = "geotiff"
    ESRI_ASCII = "esri-ascii"
    XYZ = "xyz"


MapId = Annotated[str, typer.Argument(help="Id of the map (map_...).")]


@app.command("build")
@reported
def build(
    level: Annotated[str, typer.Argument(help="Id of the level (lvl_...).")],
    features: Annotated[
        Features, typer.Option(help="vector: east, north, up; hv: horizontal, vertical; total: magnitude.")
    ] = Features.VECTOR,
    cell: Annotated[float, typer.Option(help="Grid spacing, metres.")] = 0.5,
    mapped: Annotated[float, typer.Option(help="A node this near to a survey sample counts as mapped, metres.")] = 1.5,
    align: Annotated[
        bool,
        typer.Option(help="Align walks with one another; not for calibrated devices along lines that hardly cross."),
    ] = True,
    draft: Annotated[
        bool, typer.Option("--draft", help="Only build it; publish it later with `isodyn map publish`.")
    ] = False,
    survey: Annotated[list[str] | None, typer.Option(help="Only from these surveys; may be repeated.")] = None,
    url: Url = DEFAULT_URL,
    key: Key = None,
) -> None:
    """Build a map of a level from its survey walks; it becomes the current one, unless it is a draft. Prints its id.

    Example:  isodyn map build lvl_... --cell 0.5
    """
    with connect(url, key) as client, progress_bars() as bars:
        bar = bars.add_task("building the map", total=1.0, text="")
        info = client.build_map(
            level,
            survey_ids=survey or None,
            features=features.value,
            cell_m=cell,
            mapped_m=mapped,
            align=align,
            publish=not draft,
            timeout=3600.0,
            progress=lambda job: bars.update(bar, completed=job.progress, text=job.progress_text),
        )
        bars.update(bar, completed=1.0, text=f"version {info.version}, {info.build_s:.1f} s")
    typer.echo(info.id)


@app.command("update")
@reported
def update(
    level: Annotated[str, typer.Argument(help="Id of the level (lvl_...).")], url: Url = DEFAULT_URL, key: Key = None
) -> None:
    """Bring a level's map up to date: add walks uploaded since, take out those deleted. Prints the new map's id.

    Only what these walks touch is computed anew, which takes a second or so; what was fitted to the level (covariance,
    noise) stays until the next build.

    Example:  isodyn map update lvl_...
    """
    with connect(url, key) as client, progress_bars() as bars:
        bar = bars.add_task("updating the map", total=1.0, text="")
        info = client.update_map(
            level, progress=lambda job: bars.update(bar, completed=job.progress, text=job.progress_text)
        )
        bars.update(bar, completed=1.0, text=f"version {info.version}, {info.build_s:.1f} s")
    typer.echo(info.id)


@app.command("list")
@reported
def list_maps(
    level: Annotated[str | None, typer.Option(help="Only maps of this level.")] = None,
    url: Url = DEFAULT_URL,
    key: Key = None,
) -> None:
    """List map versions, newest first.

    Example:  isodyn map list --level lvl_...
    """
    with connect(url, key) as client:
        rows = [
            (
                info.id,
                info.level_id,
                info.version,
                info.features.value,
                f"{info.columns} x {info.rows}",
                f"{info.mapped_area_m2:.0f} m2 ({100 * info.mapped_share:.0f} %)",
                info.n_walks,
            )
            for info in client.maps(level_id=level)
        ]
    print_table(("map", "level", "version", "features", "nodes", "mapped", "walks"), rows, empty="no maps yet")


@app.command("show")
@reported
def show(map_id: MapId, url: Url = DEFAULT_URL, key: Key = None) -> None:
    """Show a map version: size, coverage, what was fitted, and how well each survey walk agrees with the rest.

    Example:  isodyn map show map_...
    """
    with connect(url, key) as client:
        info = client.map_info(map_id)
    size = f"{info.columns} x {info.rows} nodes, {info.cell_m:g} m apart, from ({info.x0:g}, {info.y0:g}) m"
    print_table(
        ("map", info.id),
        [
            ("level, version", f"{info.level_id}, {info.version}"),
            ("features", info.features.value),
            ("grid", size),
            ("mapped", f"{info.mapped_area_m2:.0f} m2, {100 * info.mapped_share:.0f} % (within {info.mapped_m:g} m)"),
            ("survey", f"{info.n_walks} walks, {info.n_samples} samples"),
            ("field spread (uT)", ", ".join(f"{value:.1f}" for value in info.field_sd)),
            ("repeatability (uT)", ", ".join(f"{value:.1f}" for value in info.noise_sd)),
            ("radio", _radio(info)),
            ("lines", "not kept" if info.n_routes is None else f"{info.n_routes}, as walked"),
            ("length scale", f"{info.length_scale_m:.2f} m"),
            ("built", f"{info.created_at:%Y-%m-%d %H:%M} UTC in {info.build_s:.1f} s"),
            *([] if info.origin is None else [("imported", _origin(info.origin))]),
            ("content hash", info.hash),
        ],
    )
    print_table(
        ("walk", "steps", "length (m)", "offset (uT)", "residual (uT)", ""),
        [
            (
                walk.walk_id,
                walk.n_steps,
                f"{walk.length_m:.0f}",
                ", ".join(f"{value:+.1f}" for value in walk.offset),
                f"{walk.residual_rms:.1f}",
                walk.rejected or "",
            )
            for walk in info.walks
        ],
    )


def _origin(origin: isodyn.MapOrigin) -> str:
    words = (origin.title, origin.licence, origin.attribution, *origin.assumed)
    return "; ".join([f"{origin.format}, sha256 {origin.file_hash[:12]}", *(one for one in words if one)])


def _radio(info: isodyn.MapInfo) -> str:
    if info.n_transmitters is None:
        return "none: no readings in the survey"
    return f"{info.n_transmitters} access points and beacons, nodes {info.radio_cell_m:g} m apart"


@app.command("export")
@reported
def export(
    map_id: MapId,
    file: Annotated[
        Path | None,
        typer.Argument(help="Where to write a picture or an array: .png (colours, north up) or .npy (NaN unmapped)."),
    ] = None,
    output: Annotated[Path | None, typer.Option("--output", "-o", help="Where to write, with --format.")] = None,
    format: Annotated[  # noqa: A002
        MapFormat | None,
        typer.Option(help="The whole map for other programs: netCDF (CF), GeoTIFF or ESRI ASCII (zip files), or XYZ."),
    ] = None,
    licence: Annotated[str | None, typer.Option(help="With --format: the licence that the file shall name.")] = None,
    channel: Annotated[
        str, typer.Option(help="x, y, z (vector maps), h, v (hv maps), or total: the magnitude.")
    ] = "total",
    statistic: Annotated[
        Statistic, typer.Option(help="mean and sd in uT; support: metres to the nearest survey sample.")
    ] = Statistic.MEAN,
    url: Url = DEFAULT_URL,
    key: Key = None,
) -> None:
    """Write a map to a file: one channel as a picture or array, or all of it in a format that other programs read.

    In a .npy file row 0 is the southern edge: the node of row r and column c lies at (x0 + c*cell, y0 + r*cell) metres;
    x0, y0 and cell are printed.

    Example:  isodyn map export map_... field.png --channel z
    Example:  isodyn map export map_... sd.npy --channel z --statistic sd
    Example:  isodyn map export map_... --format netcdf -o hall.nc --licence "CC BY 4.0"
    """
    from app.cli.errors import InputFileError

    file = output or file
    if file is None:
        raise typer.BadParameter("name a FILE, or give --format and -o")
    if format is not None:
        with connect(url, key) as client:
            file.write_bytes(client.export_map(map_id, format=format.value, licence=licence))
        typer.echo(f"{file}: {format.value}, {file.stat().st_size} bytes")
        return
    if file.suffix.lower() not in {".png", ".npy"}:
        raise InputFileError(file, "name a .png or a .npy file, or give --format")
    with connect(url, key) as client:
        if file.suffix.lower() == ".png":
            file.write_bytes(client.map_image(map_id, channel, statistic=statistic.value))
            typer.echo(f"{file}: {channel}, {statistic.value}")
            return
        import numpy as np

        raster = client.map_field(map_id, channel, statistic=statistic.value)
        with file.open("wb") as target:
            np.save(target, raster.values)
    rows, columns = raster.values.shape
    typer.echo(f"{file}: {rows} x {columns}, x0 {raster.x0:g} m, y0 {raster.y0:g} m, cell {raster.cell_m:g} m")
