"""``isodyn demo``: the whole way on a real floor, with a service of its own."""

from __future__ import annotations

import shutil
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from app.cli.common import connect, progress_bars, reported

if TYPE_CHECKING:
    from rich.progress import Progress as Bars

    from app.cli.process import OwnService
    from app.cli.transport import ServiceTransport
    from app.engine.types import Progress
    from app.evaluation.datasets.ilc20 import Ilc20Level, RecordedWalk
    from app.evaluation.report import Report

LEVEL = "site1-F2"
SAMPLES = Path(__file__).resolve().parents[2] / "maps" / "samples"


@reported
def demo(
    keep: Annotated[
        bool, typer.Option("--keep", envvar="KEEP", help="Leave the service running; print its address and key.")
    ] = False,
    walks: Annotated[int | None, typer.Option(min=1, help="Test walks to replay.", show_default="all 18")] = None,
    out: Annotated[Path, typer.Option(help="Folder for the plots.")] = Path("demo-out"),
    data: Annotated[
        Path, typer.Option(help="Folder that holds ilc20/site1-F2.", show_default="maps/samples")
    ] = SAMPLES,
) -> None:
    """Show the whole way: survey, map, sessions, fixes, on a real floor of a shopping mall.

    Starts a service on a free port with a fresh database, uploads the survey walks of a floor over HTTP, builds its
    magnetic map, sends other people's walks as sessions of 5-second segments, compares the fixes with the labels, draws
    one plot a walk, and stops the service.

    Example:  isodyn demo --keep
    """
    from app.cli.transport import ServiceTransport
    from app.cli.trips import verdict, walk_table
    from app.cli.uploads import choose_walks
    from app.evaluation.datasets.ilc20 import open_ilc20

    began = time.monotonic()
    level = open_ilc20(data).level(LEVEL)
    chosen = choose_walks(level, "test", (), walks)
    with _service(keep=keep) as service:
        with connect(service.url, service.key) as client, progress_bars() as bars:
            transport = ServiceTransport(client)
            level_id = _survey(transport, level, bars)
            report = _replay(transport, level, level_id, chosen, bars)
            plots = _plot(transport, level, level_id, report, out, bars)
        typer.echo()
        typer.echo(walk_table(report))
        typer.echo()
        typer.echo(verdict(report))
        for left_out in report.dropped:
            typer.echo(f"not scored: {left_out.walk_id} ({left_out.reason})")
        typer.echo(f"{len(plots)} plots in {out}/, {time.monotonic() - began:.0f} s in all")
        if keep:
            _say_how_to_go_on(service, level_id)


@contextmanager
def _service(*, keep: bool) -> Iterator[OwnService]:
    """A service in a folder of its own; with ``keep`` both stay if all went well."""
    from app.cli.process import start_service, stopped_unless_kept

    folder = Path(tempfile.mkdtemp(prefix="isodyn-demo-"))
    kept = False
    try:
        with progress_bars() as bars:
            bars.add_task("starting the service", total=None, text="the first start compiles the kernels")
            service = start_service(folder / "data")
        with stopped_unless_kept(service, keep=keep):
            yield service
            kept = keep
    finally:
        if not kept:
            shutil.rmtree(folder, ignore_errors=True)


def _survey(transport: ServiceTransport, level: Ilc20Level, bars: Bars) -> str:
    """Create the level, upload its survey walks, build its map."""
    from app.cli.uploads import level_upload
    from app.engine.types import MapBuildSettings

    survey = [walk.survey_walk() for walk in level.walks("train")]
    level_id = transport.add_level(level_upload(level))
    transport.add_walks(level_id, survey, _bar(bars, "uploading survey walks"))
    building = _bar(bars, "building the map")
    transport.build_map(level_id, MapBuildSettings(), building)
    building(1.0, "")
    return level_id


def _replay(
    transport: ServiceTransport, level: Ilc20Level, level_id: str, walks: list[RecordedWalk], bars: Bars
) -> Report:
    from app.cli.trips import replay_trips

    bar = bars.add_task("replaying test walks", total=len(walks), text="")

    def done(walk: RecordedWalk) -> None:
        bars.update(bar, advance=1, text=f"{walk.path_length_m:.0f} m")

    return replay_trips(transport, level, level_id, walks, method="", done=done)


def _plot(
    transport: ServiceTransport, level: Ilc20Level, level_id: str, report: Report, out: Path, bars: Bars
) -> list[Path]:
    from app.cli.trips import plot_trips

    drawing = _bar(bars, "drawing plots")
    paths = plot_trips(transport, level, level_id, report, out, drawing)
    drawing(1.0, "")
    return paths


def _bar(bars: Bars, name: str) -> Progress:
    bar = bars.add_task(name, total=1.0, text="")

    def show(fraction: float, text: str) -> None:
        bars.update(bar, completed=fraction, text=text)

    return show


def _say_how_to_go_on(service: OwnService, level_id: str) -> None:
    typer.echo(
        f"""
The service runs on:
  address   {service.url}   (the dashboard; all calls: {service.url}/docs)
  data      {service.data_dir}
  stop it   kill {service.process.pid}

  export ISODYN_URL={service.url}
  export ISODYN_KEY={service.key}
  isodyn survey levels
  isodyn replay {SAMPLES / "ilc20" / LEVEL} --level {level_id} --limit 3
"""
    )
