"""``isodyn evaluate``: replay public data sets and print the table that a user of the method would ask for."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from app.cli.common import NAMED, Key, connect, progress_bars, reported

if TYPE_CHECKING:
    from app.engine.types import Progress
    from app.evaluation.drivers import Transport
    from app.evaluation.protocol import EvaluationOptions
    from app.evaluation.report import Report

app = typer.Typer(context_settings=NAMED, no_args_is_help=True, help="Replay data sets and score the fixes.")


class Scenario(StrEnum):
    """What is known at the start of a walk."""

    TRACKING = "tracking"
    COLD = "cold"
    VENUE = "venue"


class Aids(StrEnum):
    """What is sent beside the magnetometer and inertial samples."""

    NONE = "none"
    WIFI = "wifi"


class Through(StrEnum):
    """Where the walks are replayed."""

    ENGINE = "engine"
    HTTP = "http"


@app.callback()
def evaluate() -> None:
    """Replay data sets and score the fixes."""


@app.command("ilc20")
@reported
def ilc20(
    data: Annotated[Path, typer.Option(help="Folder that holds ilc20/<site>-<floor>/ (or that folder itself).")],
    levels: Annotated[
        str,
        typer.Option(help="Names separated by commas, such as site1-F2,site1-B1.", show_default="all that are found"),
    ] = "",
    scenario: Annotated[
        Scenario, typer.Option(help="tracking: start known within 3 m; cold: the level; venue: the building.")
    ] = Scenario.TRACKING,
    aids: Annotated[Aids, typer.Option(help="Send the walks' Wi-Fi readings too, or not.")] = Aids.NONE,
    through: Annotated[
        Through, typer.Option(help="Call the engine, or send the walks through a service over HTTP.")
    ] = Through.ENGINE,
    jobs: Annotated[int, typer.Option(min=1, help="Walks side by side.")] = 1,
    json_file: Annotated[
        Path | None, typer.Option("--json", help="Write the report here: every walk, every error.")
    ] = (None),
    plots: Annotated[Path | None, typer.Option(help="Folder for one plot a walk and the error distribution.")] = None,
    method: Annotated[str, typer.Option(help="Positioning method.", show_default="the default one")] = "",
    limit: Annotated[int | None, typer.Option(min=1, help="At most so many test walks a level.")] = None,
    repeat: Annotated[int, typer.Option(help="Another number draws other priors and seeds.")] = 0,
    cache: Annotated[Path | None, typer.Option(help="Folder that keeps built maps for the next run.")] = None,
    url: Annotated[
        str | None,
        typer.Option(
            help="With --through http: a running service; without it one is started for the run.",
            rich_help_panel="Service",
        ),
    ] = None,
    key: Key = None,
) -> None:
    """Evaluate on walks in the ilc20 folder format: maps from the train split, errors on the test split.

    Error: horizontal distance in metres of the causal fix to the truth, at every step after the first 5 s. Covered
    walks have a survey sample within 1 m of at least 80 % of their steps. docs/uncertainty.md explains the columns.

    Example:  isodyn evaluate ilc20 --data maps/samples

    Example:  isodyn evaluate ilc20 --data DIR --levels site1-F2 --through http --json report.json --plots plots
    """
    from app.engine.types import MapBuildSettings
    from app.evaluation import protocol

    options = protocol.EvaluationOptions(
        data=data,
        levels=tuple(name.strip() for name in levels.split(",") if name.strip()),
        scenario=protocol.Scenario(scenario.value),
        aids=protocol.Aids(aids.value),
        through=protocol.Through(through.value),
        jobs=jobs,
        plots=plots,
        cache=cache,
        method=method,
        map_settings=MapBuildSettings(),
        limit=limit,
        repeat=repeat,
    )
    with progress_bars() as bars:
        bar = bars.add_task("evaluating", total=1.0, text="")
        report = run(options, url, key, lambda fraction, text: bars.update(bar, completed=fraction, text=text))
    if json_file:
        json_file.parent.mkdir(parents=True, exist_ok=True)
        json_file.write_text(report.to_json())
    typer.echo(report.table())


def run(options: EvaluationOptions, url: str | None, key: str | None, progress: Progress) -> Report:
    """Run an evaluation, through the engine or through a service."""
    from app.evaluation.protocol import Through as Way
    from app.evaluation.run import run_ilc20

    if options.through is not Way.HTTP:
        return run_ilc20(options, progress)
    with service_transport(url, key) as transport:
        return run_ilc20(options, progress, transport=transport)


@contextmanager
def service_transport(url: str | None, key: str | None) -> Iterator[Transport]:
    """A transport to the service at ``url``; without one, to a service that lives as long as the block."""
    import tempfile

    from app.cli.process import start_service, stopped_unless_kept
    from app.cli.transport import ServiceTransport

    if url:
        with connect(url, key) as client:
            yield ServiceTransport(client)
        return
    with (
        tempfile.TemporaryDirectory(prefix="isodyn-evaluate-") as folder,
        stopped_unless_kept(start_service(Path(folder) / "data")) as service,
        connect(service.url, service.key) as client,
    ):
        yield ServiceTransport(client)
