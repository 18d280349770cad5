"""``isodyn evaluate``: replay public data sets and print the table that a user of the method would ask for."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeAlias, TypeVar

import typer

from app.cli.common import NAMED, Key, connect, progress_bars, reported

if TYPE_CHECKING:
    from app.engine.types import Progress
    from app.evaluation.crowd import CrowdReport
    from app.evaluation.drivers import Transport
    from app.evaluation.field import FieldReport
    from app.evaluation.fleet import FleetReport
    from app.evaluation.forecast import ForecastReport
    from app.evaluation.kaist import KaistReport
    from app.evaluation.papers.report import PapersReport
    from app.evaluation.protocol import EvaluationOptions
    from app.evaluation.report import Report
    from app.evaluation.uji import UjiReport

R = TypeVar("R")

app = typer.Typer(context_settings=NAMED, no_args_is_help=True, help="Replay data sets and score the fixes.")


class Scenario(StrEnum):
    """What is known at the start of a walk."""

    TRACKING = "tracking"
    COLD = "cold"
    VENUE = "venue"


class Through(StrEnum):
    """Where the walks are replayed."""

    ENGINE = "engine"
    HTTP = "http"


Ilc20Data = Annotated[
    Path, typer.Option("--data", help="Folder that holds ilc20/<site>-<floor>/ (or that folder itself).")
]
Levels = Annotated[
    str,
    typer.Option(help="Names separated by commas, such as site1-F2,site1-B1.", show_default="all that are found"),
]
Jobs = Annotated[int, typer.Option(min=1, help="Walks side by side.")]
JsonFile = Annotated[Path | None, typer.Option("--json", help="Write the report here: every walk, every error.")]
Plots = Annotated[Path | None, typer.Option(help="Folder for one plot a walk and the error distribution.")]
Method = Annotated[str, typer.Option(help="Positioning method.", show_default="the default one")]
Cache = Annotated[Path | None, typer.Option(help="Folder that keeps built maps for the next run.")]


@app.callback()
def evaluate() -> None:
    """Replay data sets and score the fixes."""


@app.command("ilc20")
@reported
def ilc20(
    data: Ilc20Data,
    levels: Levels = "",
    scenario: Annotated[
        Scenario, typer.Option(help="tracking: start known within 3 m; cold: the level; venue: the building.")
    ] = Scenario.TRACKING,
    aids: Annotated[
        str, typer.Option(help="Readings sent with survey and test walks: none, wifi, ble or wifi,ble.")
    ] = "none",
    through: Annotated[
        Through, typer.Option(help="Call the engine, or send the walks through a service over HTTP.")
    ] = Through.ENGINE,
    jobs: Jobs = 1,
    json_file: JsonFile = None,
    plots: Plots = None,
    method: Method = "",
    limit: Annotated[int | None, typer.Option(min=1, help="At most so many test walks a level.")] = None,
    repeat: Annotated[int, typer.Option(help="Another number draws other priors and seeds.")] = 0,
    cache: Cache = None,
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
    With --scenario venue all levels of a building that are in the folder get a map, also those not named in --levels,
    and a fix on a wrong level is wrong wherever it lies.

    Example:  isodyn evaluate ilc20 --data maps/samples

    Example:  isodyn evaluate ilc20 --data DIR --levels site1-F2 --through http --json report.json --plots plots
    """
    from app.engine.types import MapBuildSettings
    from app.evaluation import protocol

    options = protocol.EvaluationOptions(
        data=data,
        levels=_names(levels),
        scenario=protocol.Scenario(scenario.value),
        aids=protocol.Aids.parse(aids),
        through=protocol.Through(through.value),
        jobs=jobs,
        plots=plots,
        cache=cache,
        method=method,
        map_settings=MapBuildSettings(),
        limit=limit,
        repeat=repeat,
    )
    report = with_progress(lambda progress: run(options, url, key, progress))
    publish(report, json_file)


@app.command("forecast")
@reported
def forecast(
    data: Ilc20Data,
    levels: Levels = "",
    json_file: JsonFile = None,
    limit: Annotated[int | None, typer.Option(min=1, help="At most so many walks left out a level.")] = None,
) -> None:
    """Compare the forecast of accuracy with what is achieved, on survey walks that the map does not hold.

    One walk of the train split in four is left out, the map is built of the rest, and the walks left out are tracked on
    it. Beside the root mean square error of each walk, and of each 10 m, stands what the forecast expected.

    Example:  isodyn evaluate forecast --data maps/samples
    """
    from app.evaluation.forecast import run_forecast
    from app.evaluation.protocol import EvaluationOptions

    named = _names(levels)
    options = EvaluationOptions(data=data, levels=named, limit=limit)
    publish(with_progress(lambda progress: run_forecast(options, say=progress)), json_file)


@app.command("kaist")
@reported
def kaist(
    data: Annotated[Path, typer.Option(help="Folder that holds kaist/<floor>/ (or that folder itself).")],
    floor: Annotated[str, typer.Option(help="Floor to evaluate.")] = "KI-1F",
    device: Annotated[
        str, typer.Option(help="Only tracks of this phone: S9, Mate20, iPhone.", show_default="all phones")
    ] = "",
    runs: Annotated[int, typer.Option(min=1, help="Runs a track; they differ by seed.")] = 100,
    jobs: Jobs = 1,
    json_file: JsonFile = None,
    plots: Plots = None,
    method: Method = "",
    cache: Cache = None,
) -> None:
    """Evaluate on the hall with repeat tracks: cold starts, many runs a track, beside the published results.

    Map from the survey lines. The source's protocol scores a run at the corners of its track but the first two, and
    calls it converged when their mean error is below 9 m. Beside it: errors at every step of all runs, and the
    distance walked until the first fix that claims a position.

    Example:  isodyn evaluate kaist --data DIR --device S9 --runs 100 --json kaist.json
    """
    from app.evaluation.kaist import KaistOptions, run_kaist

    options = KaistOptions(
        data=data, floor=floor, device=device, runs=runs, jobs=jobs, plots=plots, cache=cache, method=method
    )
    publish(with_progress(lambda progress: run_kaist(options, progress)), json_file)


@app.command("uji")
@reported
def uji(
    data: Annotated[Path, typer.Option(help="Folder that holds uji/ (or that folder itself).")],
    runs: Annotated[int, typer.Option(min=1, help="Runs a walk; they differ by seed.")] = 10,
    jobs: Jobs = 1,
    json_file: JsonFile = None,
    plots: Plots = None,
    method: Method = "",
    cache: Cache = None,
) -> None:
    """Evaluate on the laboratory walks: start pose known, as the published run assumes, and unknown.

    Map from the train walks. Errors at every step from the first label on, beside the published mean.

    Example:  isodyn evaluate uji --data DIR --json uji.json
    """
    from app.evaluation.uji import UjiOptions, run_uji

    options = UjiOptions(data=data, runs=runs, jobs=jobs, plots=plots, cache=cache, method=method)
    publish(with_progress(lambda progress: run_uji(options, progress)), json_file)


@app.command("field")
@reported
def field(
    data: Ilc20Data,
    levels: Levels = "",
    json_file: JsonFile = None,
) -> None:
    """Score the maps themselves: the field they predict along walks that they have not seen, and their deviation.

    Maps from the train split, prediction along the test split. Each walk's own offset is removed. Beside the map stands
    the plain mean of the survey's readings in each cell of half a metre, at the steps whose cell has any.

    Example:  isodyn evaluate field --data DIR --levels site1-F2 --json field.json
    """
    from app.evaluation.field import FieldOptions, run_field

    options = FieldOptions(data=data, levels=_names(levels))
    publish(with_progress(lambda progress: run_field(options, progress)), json_file)


@app.command("crowd")
@reported
def crowd(
    data: Ilc20Data,
    levels: Levels = "",
    rounds: Annotated[
        int, typer.Option(min=1, help="Times that the sessions are located anew on the map they have made.")
    ] = 2,
    aids: Annotated[
        str, typer.Option(help="Readings that survey and sessions bring besides: none, wifi, ble or wifi,ble.")
    ] = "none",
    left_out: Annotated[
        float | None,
        typer.Option(help="Score this share of the train walks, kept out of all maps, in place of the test walks."),
    ] = None,
    json_file: JsonFile = None,
    limit: Annotated[int | None, typer.Option(min=1, help="At most so many scored walks a level.")] = None,
    seed: Annotated[int, typer.Option(help="Another number shares the walks out otherwise.")] = 0,
) -> None:
    """See what a map gains by its users: a third of the survey, then the rest of the walks without their waypoints.

    The other two thirds come as sessions of users who opted in, each begun within 3 m of a known place. They are
    located on the map, contribute where they are sure, are weighed against one another, and the map is made anew. Test
    walks are tracked on three maps: of the third, of the crowd, and of the full survey.

    Example:  isodyn evaluate crowd --data DIR --levels site1-F2 --json crowd.json
    """
    from app.evaluation.crowd import CrowdOptions, run_crowd
    from app.evaluation.protocol import Aids

    options = CrowdOptions(
        data=data,
        levels=_names(levels),
        rounds=rounds,
        aids=Aids.parse(aids),
        left_out=left_out,
        limit=limit,
        seed=seed,
    )
    publish(with_progress(lambda progress: run_crowd(options, progress)), json_file)


@app.command("fleet")
@reported
def fleet(
    data: Ilc20Data,
    levels: Levels = "",
    folds: Annotated[int, typer.Option(min=2, help="Parts in which the train walks are left out.")] = 4,
    track: Annotated[
        bool, typer.Option("--track/--no-track", help="Replay the left-out walks, or compare offsets only.")
    ] = True,
    json_file: JsonFile = None,
    method: Method = "",
) -> None:
    """Tell what it is worth to know a phone: start-up offset and first ten seconds of left-out train walks.

    Walks of the train split are left out in turn; the others build the map and teach their phones. A left-out walk then
    starts with nothing, with what its model's other phones have in common, and with its own phone's memory too.

    Example:  isodyn evaluate fleet --data DIR --levels site1-F2 --json fleet.json
    """
    from app.evaluation.fleet import FleetOptions, run_fleet

    wanted = _names(levels)
    options = FleetOptions(data=data, levels=wanted, folds=folds, track=track, method=method)
    publish(with_progress(lambda progress: run_fleet(options, progress)), json_file)


@app.command("papers")
@reported
def papers(
    data: Annotated[Path, typer.Option(help="Folder that holds aero/ (s4), uji/ and kaist/ (s1; s3 needs uji/).")],
    only: Annotated[str, typer.Option(help="Papers separated by commas: s1, s3, s4.", show_default="all of them")] = "",
    json_file: JsonFile = None,
    plots: Annotated[Path | None, typer.Option(help="Folder for plots of regions and of errors.")] = None,
    tracks: Annotated[int, typer.Option(min=1, help="Tracks a region, windows a data set, simulated walks.")] = 100,
    jobs: Annotated[int, typer.Option(min=1, help="Processes side by side.")] = 1,
    cache: Cache = None,
) -> None:
    """Put the matchers through the protocols of the papers they come from, on recorded fields where there are any.

    s4: contour matching over an area (Cheng, Zhou 2026) on aeromagnetic anomalies. s1: windows slid along a stored
    sequence (Zhang 2021) on the laboratory's and the hall's walks and a simulated cart. s3: three-axis voting without
    odometry and headings corrected by the map (Bao, Shang, Shi 2019) on the laboratory's walks, a simulated lane and a
    simulated office. The papers' figures stand below ours, with what may be compared.

    Example:  isodyn evaluate papers --data DIR --only s4 --tracks 20 --json papers.json --plots plots
    """
    from app.evaluation.papers.run import PapersOptions, run_papers

    options = PapersOptions(
        data=data,
        only=tuple(name.strip() for name in only.split(",") if name.strip()),
        tracks=tracks,
        jobs=jobs,
        plots=plots,
        cache=cache,
    )
    publish(with_progress(lambda progress: run_papers(options, progress)), json_file)


@app.command("plot")
@reported
def plot(
    reports: Annotated[list[Path], typer.Argument(help="Reports written with --json.")],
    out: Annotated[Path, typer.Option(help="PNG to write.")] = Path("errors.png"),
) -> None:
    """Draw the error distributions of several reports in one picture, with published figures as lines.

    Example:  isodyn evaluate plot tracking.json cold.json cold-wifi.json --out errors.png
    """
    import json

    from app.cli.errors import InputFileError
    from app.evaluation.distributions import plot_reports

    contents = []
    for file in reports:
        try:
            contents.append(json.loads(file.read_text()))
            missing = {"set", "scenario", "aids", "walks"} - contents[-1].keys()
        except (ValueError, AttributeError) as error:
            raise InputFileError(file, f"is not a report ({error})") from error
        if missing:
            raise InputFileError(file, f"is not a report: it lacks {', '.join(sorted(missing))}")
    typer.echo(plot_reports(contents, out))


def _names(listed: str) -> tuple[str, ...]:
    """Names of a list that commas separate."""
    return tuple(name.strip() for name in listed.split(",") if name.strip())


def with_progress(work: Callable[[Progress], R]) -> R:
    """Do the work behind a progress bar."""
    with progress_bars() as bars:
        bar = bars.add_task("evaluating", total=1.0, text="")
        return work(lambda fraction, text: bars.update(bar, completed=fraction, text=text))


AnyReport: TypeAlias = (
    "Report | CrowdReport | FieldReport | FleetReport | ForecastReport | KaistReport | UjiReport | PapersReport"
)


def publish(report: AnyReport, json_file: Path | None) -> None:
    """Write the report, print its table."""
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
