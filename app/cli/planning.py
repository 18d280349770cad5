"""``isodyn map quality``, ``suggest`` and ``forecast``: how good a map is, where to walk next, what to expect."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from app.cli.common import DEFAULT_URL, Key, Url, connect, print_table, reported
from app.cli.maps import MapId

if TYPE_CHECKING:
    import isodyn_client as isodyn

_SHOWN_REGIONS = 10


class Layer(StrEnum):
    """What a raster of quality shows."""

    MEAN_ERROR = "mean_error"
    WORST_ERROR = "worst_error"
    ERROR = "error"
    ALONG = "along"
    ACROSS = "across"
    COVERAGE = "coverage"
    CONFLICT = "conflict"
    SOURCES = "sources"
    AGE = "age"


@reported
def quality(
    map_id: MapId,
    file: Annotated[
        Path | None, typer.Option("--out", help="Also write a layer here: .png (colours, north up) or .npy (float32).")
    ] = None,
    layer: Annotated[
        Layer,
        typer.Option(
            help="Of --out. mean_error, worst_error: expected error over all directions, metres; error, along, across:"
            " of the direction that --heading names; coverage: 1 mapped, 0 not; conflict: how far walks"
            " disagree, about 1 where they agree; sources: how many walks were there; age: days from"
            " the newest of them to the making of the map."
        ),
    ] = Layer.MEAN_ERROR,
    heading: Annotated[
        int | None, typer.Option(help="Direction of travel in degrees, counter-clockwise from +x: 0, 45, ... 315.")
    ] = None,
    url: Url = DEFAULT_URL,
    key: Key = None,
) -> None:
    """Show how good a map is: what of the walkable space is mapped, what accuracy to expect, where walks disagree.

    The expected error is what no method beats on average and a good one comes near to, for a phone in the hand.

    Example:  isodyn map quality map_...
    Example:  isodyn map quality map_... --out error.png --layer error --heading 90
    """
    with connect(url, key) as client:
        found = client.map_quality(map_id)
        _show(found)
        if file is not None:
            _write(client, map_id, file, layer.value, heading)


def _show(found: isodyn.MapQuality) -> None:
    coverage, conflict = found.coverage, found.conflict
    ground = "of the floor plan" if coverage.by_plan else "near mapped ground: the level has no plan"
    print_table(
        ("map", found.map_id),
        [
            ("walkable space", f"{coverage.walkable_m2:.0f} m2 ({ground})"),
            ("mapped", f"{coverage.mapped_m2:.0f} m2, {100 * coverage.mapped_share:.0f} %"),
            ("to the nearest sample", _percentiles(coverage.support_p50_m, coverage.support_p90_m)),
            ("expected error", _percentiles(found.mean_error.p50_m, found.mean_error.p90_m)),
            ("in the worst direction", _percentiles(found.worst_error.p50_m, found.worst_error.p90_m)),
            (
                "conflicts",
                "not known: the map was stored without its evidence"
                if conflict is None
                else f"{conflict.conflict_cells} of {conflict.shared_cells} square metres that several walks passed",
            ),
        ],
    )
    print_table(
        ("part of the walkable space (m)", "area (m2)", "mapped"),
        [
            (
                f"x {part.x_min:.0f} to {part.x_max:.0f}, y {part.y_min:.0f} to {part.y_max:.0f}",
                f"{part.area_m2:.0f}",
                f"{100 * part.mapped_share:.0f} %",
            )
            for part in coverage.regions[:_SHOWN_REGIONS]
        ],
    )


def _percentiles(p50: float | None, p90: float | None) -> str:
    return "nothing is mapped" if p50 is None or p90 is None else f"{p50:.1f} m in the middle, {p90:.1f} m at the 90th"


def _write(client: isodyn.Client, map_id: str, file: Path, layer: str, heading: int | None) -> None:
    from app.cli.errors import InputFileError

    if file.suffix.lower() == ".png":
        file.write_bytes(client.quality_image(map_id, layer, heading_deg=heading))
        typer.echo(f"{file}: {layer}")
    elif file.suffix.lower() == ".npy":
        import numpy as np

        raster = client.quality_raster(map_id, layer, heading_deg=heading)
        with file.open("wb") as target:
            np.save(target, raster.values)
        typer.echo(f"{file}: {layer}, x0 {raster.x0:g} m, y0 {raster.y0:g} m, cell {raster.cell_m:g} m")
    else:
        raise InputFileError(file, "name a .png or a .npy file")


@reported
def suggest(
    map_id: MapId,
    count: Annotated[int, typer.Option(help="How many lines at most (1 to 50).")] = 10,
    geojson: Annotated[
        Path | None,
        typer.Option(help="Write the lines as GeoJSON in WGS 84 instead; the venue needs an anchor."),
    ] = None,
    url: Url = DEFAULT_URL,
    key: Key = None,
) -> None:
    """Suggest where to walk next: straight lines that would teach the map most per metre, best first, with reasons.

    Each line counts those before it as walked. The column "teaches" tells how much unknown ground it is worth.

    Example:  isodyn map suggest map_... --count 5
    """
    with connect(url, key) as client:
        if geojson is not None:
            geojson.write_bytes(client.suggestions_geojson(map_id, count=count))
            typer.echo(f"{geojson}: lines in WGS 84")
            return
        found = client.survey_suggestions(map_id, count=count)
    print_table(
        ("", "from (m)", "to (m)", "length (m)", "teaches (m2)", "why"),
        [
            (
                number,
                "{:.1f}, {:.1f}".format(*line.start),
                "{:.1f}, {:.1f}".format(*line.end),
                f"{line.length_m:.0f}",
                f"{line.gain_m2:.0f}",
                line.words,
            )
            for number, line in enumerate(found.suggestions, 1)
        ],
        empty="nothing to suggest: the walkable space is well mapped",
    )


@reported
def forecast(
    map_id: MapId,
    route: Annotated[str, typer.Option(help='Corners in level metres: "x,y x,y ...".')],
    known: Annotated[float, typer.Option(help="How well the start is known: standard deviation, metres.")] = 3.0,
    url: Url = DEFAULT_URL,
    key: Key = None,
) -> None:
    """Forecast how accurate positions will be along a planned route, and where they will be lost or doubtful.

    Example:  isodyn map forecast map_... --route "12,4 40,4 40,20"
    """
    corners = _corners(route)
    with connect(url, key) as client:
        found = client.forecast_route(map_id, corners, known_m=known)
    print_table(
        ("route", f"{found.length_m:.0f} m"),
        [
            ("mapped", f"{100 * found.mapped_share:.0f} %"),
            ("expected error", f"{found.mean_m:.1f} m in the mean, {found.p90_m:.1f} m at the 90th percentile"),
        ],
    )
    step = max(len(found.way_m) // 20, 1)
    print_table(
        ("walked (m)", "at (m)", "along (m)", "across (m)", "error (m)", ""),
        [
            (
                f"{found.way_m[i]:.0f}",
                f"{found.x[i]:.1f}, {found.y[i]:.1f}",
                f"{found.along_m[i]:.1f}",
                f"{found.across_m[i]:.1f}",
                f"{found.error_m[i]:.1f}",
                "" if found.mapped[i] else "not mapped",
            )
            for i in range(0, len(found.way_m), step)
        ],
    )
    print_table(
        ("from (m)", "to (m)", "trouble"),
        [(f"{part.from_m:.0f}", f"{part.to_m:.0f}", _words(part)) for part in found.stretches],
        empty="no trouble on the way",
    )


def _words(part: isodyn.Stretch) -> str:
    if part.trouble == "unmapped":
        return "not mapped: only dead reckoning"
    if part.trouble == "lost":
        return "the position will be off by more than 5 m"
    return f"looks like a place {part.rival_m:.0f} m away: a session that starts on the way may be put there"


def _corners(route: str) -> list[tuple[float, float]]:
    try:
        corners = [(float(x), float(y)) for x, y in (corner.split(",") for corner in route.split())]
    except ValueError as error:
        raise typer.BadParameter('needs corners as "x,y x,y"', param_hint="--route") from error
    if len(corners) < 2:
        raise typer.BadParameter("needs two corners at least", param_hint="--route")
    return corners
