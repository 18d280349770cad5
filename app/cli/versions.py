"""``isodyn map publish``, ``rollback``, ``history``, ``sources``, ``diff``: versions of a level's map."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from app.cli.common import DEFAULT_URL, Key, Url, connect, print_table, reported

if TYPE_CHECKING:
    import isodyn_client as isodyn


class ChangeStatistic(StrEnum):
    """What an image of the difference shows."""

    CHANGE = "change"
    SIGNIFICANCE = "significance"


Level = Annotated[str, typer.Argument(help="Id of the level (lvl_...).")]
Note = Annotated[str, typer.Option(help="Why; it is kept in the history.")]


@reported
def publish(
    map_id: Annotated[str, typer.Argument(help="Id of the map (map_...), a draft or any older version.")],
    note: Note = "",
    url: Url = DEFAULT_URL,
    key: Key = None,
) -> None:
    """Make a map version the one that new sessions on its level use. Sessions that are open keep theirs.

    Example:  isodyn map publish map_... --note "checked on site"
    """
    with connect(url, key) as client:
        level_id = client.map_info(map_id).level_id
        _say(client.publish_map(level_id, map_id, note=note or None))


@reported
def rollback(level: Level, note: Note = "", url: Url = DEFAULT_URL, key: Key = None) -> None:
    """Go back to the newest version below the current one that was published before.

    Called again it goes back further. To name the version yourself, use `isodyn map publish`.

    Example:  isodyn map rollback lvl_... --note "worse at the entrance"
    """
    from app.cli.errors import CommandError

    with connect(url, key) as client:
        versions = {info.id: info.version for info in client.maps(level_id=level)}
        current = versions.get(client.level(level).current_map_id or "", 0)
        published = {one.map_id for one in client.publications(level)} | {
            one.from_map_id for one in client.publications(level) if one.from_map_id is not None
        }
        older = [map_id for map_id in published if versions.get(map_id, current) < current]
        if not older:
            raise CommandError("no older version of this level was ever published; see: isodyn map list --level ...")
        target = max(older, key=lambda map_id: versions[map_id])
        _say(client.publish_map(level, target, note=note or "rolled back"))


@reported
def history(level: Level, url: Url = DEFAULT_URL, key: Key = None) -> None:
    """Show which map version was published on a level when, by whom and why, newest first.

    Example:  isodyn map history lvl_...
    """
    with connect(url, key) as client:
        versions = {info.id: f"{info.version}" for info in client.maps(level_id=level)}
        rows = [
            (
                f"{one.created_at:%Y-%m-%d %H:%M} UTC",
                versions.get(one.map_id, "?"),
                one.map_id,
                "-" if one.from_map_id is None else versions.get(one.from_map_id, "?"),
                one.key_id or "service",
                one.note,
            )
            for one in client.publications(level)
        ]
    print_table(("published", "version", "map", "before", "by", "note"), rows, empty="nothing was published yet")


@reported
def sources(
    map_id: Annotated[str, typer.Argument(help="Id of the map (map_...).")], url: Url = DEFAULT_URL, key: Key = None
) -> None:
    """List who contributed to a map version: survey walks and sessions, and what was left out, with the reason.

    Example:  isodyn map sources map_...
    """
    with connect(url, key) as client:
        rows = [
            (
                one.id,
                one.kind,
                one.survey_id or "-",
                one.device_id or "-",
                "-" if one.n_samples is None else one.n_samples,
                "-" if one.n_used is None else one.n_used,
                one.rejected or "",
            )
            for one in client.map_sources(map_id)
        ]
    print_table(("source", "kind", "survey", "device", "samples", "used", "left out"), rows)


@reported
def diff(
    map_id: Annotated[str, typer.Argument(help="Id of the map (map_...).")],
    against: Annotated[
        str | None, typer.Option(help="Another version of the level.", show_default="the one it came from")
    ] = None,
    least: Annotated[float, typer.Option(help="A node changed if its field moved by more than this, uT.")] = 1.0,
    image: Annotated[Path | None, typer.Option(help="Write where it changed, as a PNG, north up.")] = None,
    component: Annotated[
        str, typer.Option(help="Of the image: all (length of the change), or x, y, z, h, v, total.")
    ] = "all",
    statistic: Annotated[
        ChangeStatistic, typer.Option(help="Of the image: uT, or in standard deviations of both versions.")
    ] = ChangeStatistic.CHANGE,
    url: Url = DEFAULT_URL,
    key: Key = None,
) -> None:
    """Show what a map version changed: how much of the field by how much, who came and went, which settings differ.

    Example:  isodyn map diff map_...
    Example:  isodyn map diff map_... --against map_... --image change.png
    """
    with connect(url, key) as client:
        found = client.map_diff(map_id, against=against, least_ut=least)
        if image is not None:
            png = client.map_change_image(map_id, against=against, component=component, statistic=statistic.value)
            image.write_bytes(png)
    print_table(("map", found.map_id), _rows(found))
    if found.change:
        typer.echo()
        print_table(
            ("change (uT)", "mean", "rms", "95 % below", "largest"),
            [
                (one.component, f"{one.mean:+.2f}", f"{one.rms:.2f}", f"{one.p95:.2f}", f"{one.largest:.2f}")
                for one in found.change
            ],
        )
    if image is not None:
        typer.echo(f"{image}: {component}, {statistic.value}")


def _rows(found: isodyn.MapDiff) -> list[tuple[str, str]]:
    box = found.box
    where = "nowhere" if box is None else f"({box.x_min:g}, {box.y_min:g}) to ({box.x_max:g}, {box.y_max:g}) m"
    settings = ", ".join(f"{one.name} {one.then} -> {one.now}" for one in found.settings)
    return [
        ("compared with", found.against + (" (same content)" if found.identical else "")),
        ("mapped in both", f"{found.compared.area_m2:.0f} m2"),
        (f"changed by > {found.least_ut:g} uT", f"{found.changed.area_m2:.1f} m2"),
        ("of that significant", f"{found.significant.area_m2:.1f} m2"),
        ("newly mapped", f"{found.newly_mapped.area_m2:.1f} m2"),
        ("no longer mapped", f"{found.no_longer_mapped.area_m2:.1f} m2"),
        ("differs in", where),
        ("tiles", f"{found.tiles.shared} shared, {found.tiles.new} new, {found.tiles.gone} gone"),
        ("sources", f"{found.sources.n_added} added, {found.sources.n_removed} removed"),
        ("settings", settings or "the same"),
    ]


def _say(publication: isodyn.Publication) -> None:
    instead = "" if publication.from_map_id is None else f", in place of {publication.from_map_id}"
    typer.echo(f"{publication.map_id} is published on {publication.level_id}{instead}")
