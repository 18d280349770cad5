"""``isodyn replay``: recorded walks as sessions of a running service."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from app.cli.common import DEFAULT_URL, Key, Url, connect, progress_bars, reported
from app.cli.surveys import Split


@reported
def replay(
    folder: Annotated[Path, typer.Argument(help="Data-set folder of the level (traces.parquet, imu.parquet, ...).")],
    level: Annotated[str, typer.Option(help="Id of the level (lvl_...) whose map is used.")],
    split: Annotated[Split, typer.Option(help="Which walks of the folder.")] = Split.TEST,
    walk: Annotated[
        list[str] | None, typer.Option(help="Only walks whose id starts like this; may be repeated.")
    ] = None,
    limit: Annotated[int | None, typer.Option(min=1, help="At most so many walks.")] = None,
    method: Annotated[str, typer.Option(help="Positioning method.", show_default="the service's default")] = "",
    plots: Annotated[Path | None, typer.Option(help="Folder for one plot a walk.")] = None,
    url: Url = DEFAULT_URL,
    key: Key = None,
) -> None:
    """Send recorded walks as sessions of 5-second segments, as phones would, and compare the fixes with the labels.

    Each walk starts within 3 m of its first label, heading unknown; dead reckoning is replayed beside it. Errors in
    metres, at every step after the first 5 s.

    Example:  isodyn replay maps/samples/ilc20/site1-F2 --level lvl_... --limit 5
    """
    from app.cli.transport import ServiceTransport
    from app.cli.trips import plot_trips, replay_trips, verdict, walk_table
    from app.cli.uploads import choose_walks, open_level

    data = open_level(folder)
    chosen = choose_walks(data, split.name_in_data, walk or (), limit)
    with connect(url, key) as client, progress_bars() as bars:
        transport = ServiceTransport(client)
        bar = bars.add_task("replaying walks", total=len(chosen), text="")
        report = replay_trips(
            transport,
            data,
            level,
            chosen,
            method=method,
            done=lambda one: bars.update(bar, advance=1, text=one.walk_id),
        )
        if plots:
            drawing = bars.add_task("drawing plots", total=1.0, text="")
            plot_trips(
                transport, data, level, report, plots, lambda f, text: bars.update(drawing, completed=f, text=text)
            )
    typer.echo(walk_table(report))
    typer.echo()
    typer.echo(verdict(report))
    for left_out in report.dropped:
        typer.echo(f"not scored: {left_out.walk_id} ({left_out.reason})")
