"""``isodyn bench``: how fast the numerics and the store are on this machine."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from app.cli.common import NAMED, Key, print_table, progress_bars, reported
from app.cli.demo import SAMPLES

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

    from app.evaluation.kernels import Row

app = typer.Typer(context_settings=NAMED, no_args_is_help=True, help="Time the numerics and the store on this machine.")


@app.callback()
def bench() -> None:
    """Time the numerics and the store on this machine."""


@app.command("kernels")
@reported
def kernels(
    json_file: Annotated[Path | None, typer.Option("--json", help="Write the rows here.")] = None,
    only: Annotated[str, typer.Option(help="Tasks to run, with commas between them.", show_default="all of them")] = "",
    rounds: Annotated[int, typer.Option(min=1, help="Turns that ours and the peer take; medians are told.")] = 9,
) -> None:
    """Time the kernels beside the packages that one would take without them.

    Ours and the peer take turns in one process on the same input; times are processor time, so that other programs
    count little. A peer that does less of the same work is scaled, and its name says so; one that is not installed is
    left out.

    Example:  isodyn bench kernels --only magcom_mad,particle_step --json kernels.json
    """
    from app.evaluation.kernels import run_kernels

    names = [name.strip() for name in only.split(",") if name.strip()]
    with progress_bars() as bars:
        bar = bars.add_task("timing", total=1.0, text="")
        rows = run_kernels(
            names, rounds=rounds, progress=lambda share, text: bars.update(bar, completed=share, text=text)
        )
        bars.update(bar, completed=1.0, text="")
    if json_file:
        json_file.parent.mkdir(parents=True, exist_ok=True)
        json_file.write_text(json.dumps([row.as_dict() for row in rows], indent=1))
    print_table(("task", "ours", "peer", "times", "of", "beside"), [_cells(row) for row in rows])


@app.command("store")
@reported
def store(
    levels: Annotated[int, typer.Option(min=1, help="Levels of the large store.")] = 10_000,
    beside: Annotated[int, typer.Option(min=1, help="Levels of the small store it is compared with.")] = 100,
    json_file: Annotated[Path | None, typer.Option("--json", help="Write the rows here.")] = None,
    rounds: Annotated[int, typer.Option(min=1, help="Times that each operation runs; p50 and p95 are told.")] = 200,
) -> None:
    """Time lists, searches and maps of a large store beside those of a small one.

    Both are filled in temporary SQLite files: venues of four levels in towns all over the earth, each level with a map.
    Times are processor time. What stays within twice the time of the small store is flat.

    Example:  isodyn bench store --levels 10000 --json store.json
    """
    from app.cli.store import flatness, time_store

    timings = []
    with progress_bars() as bars:
        bar = bars.add_task("timing", total=2.0, text="")
        for k, n in enumerate((beside, levels)):
            timings += time_store(n, rounds, partial(_show, bars, bar, float(k)))
        bars.update(bar, completed=2.0, text="")
    times = flatness(timings, beside, levels)
    if json_file:
        rows = [timing.as_dict() for timing in timings]
        json_file.parent.mkdir(parents=True, exist_ok=True)
        json_file.write_text(json.dumps({"timings": rows, "times": times}, indent=1))
    told = {(t.task, t.levels): f"{t.p50_ms:.2f} / {t.p95_ms:.2f} ms" for t in timings}
    print_table(
        ("operation", f"{beside} levels, p50 / p95", f"{levels} levels, p50 / p95", "times"),
        [(task, told[task, beside], told[task, levels], f"{factor:.2f}") for task, factor in times.items()],
    )


@app.command("live")
@reported
def live(
    phones: Annotated[int, typer.Option(min=1, help="Phones that push at once.")] = 50,
    seconds: Annotated[float, typer.Option(min=5.0, help="How long they do.")] = 60.0,
    level: Annotated[
        str | None,
        typer.Option(help="Level (lvl_...) of the sample floor, with a map; with --url.", show_default=False),
    ] = None,
    data: Annotated[
        Path, typer.Option(help="Folder that holds ilc20/site1-F2.", show_default="maps/samples")
    ] = SAMPLES,
    json_file: Annotated[Path | None, typer.Option("--json", help="Write the figures here.")] = None,
    url: Annotated[
        str | None, typer.Option("--url", help="A service that runs already; else one is started.", show_default=False)
    ] = None,
    key: Key = None,
) -> None:
    """Time the way from a phone's message to the fix on the screen of whoever watches.

    Starts a service with the sample floor, lets phones push recorded walks as Sensor Logger does, one message a second
    in real time, follows every session by server-sent events, and tells how long after a message was sent its fix came.

    Example:  isodyn bench live --phones 50 --seconds 60 --json live.json
    """
    from app.cli.live_load import measure
    from app.cli.live_service import service_for, walks_of_samples

    walks = walks_of_samples(data)
    with progress_bars() as bars:
        bar = bars.add_task("measuring", total=1.0, text="")
        with service_for(url, key, level, data, partial(_show, bars, bar, 0.0)) as found:
            report = measure(
                found.url, found.key, found.level_id, walks,
                phones=phones, seconds=seconds, pid=found.pid, say=partial(_show, bars, bar, 0.0),
            )  # fmt: skip
        bars.update(bar, completed=1.0, text="")
    if json_file:
        json_file.parent.mkdir(parents=True, exist_ok=True)
        json_file.write_text(json.dumps(report.as_dict(), indent=1))
    rows = [
        ("message to fix", report.measured, report.latency_ms),
        ("message to answer", report.messages, report.answer_ms),
    ]
    print_table(
        ("", "messages", "p50 (ms)", "p95 (ms)", "p99 (ms)"),
        [(name, n, *(f"{told.get(q, float('nan')):.0f}" for q in ("p50", "p95", "p99"))) for name, n, told in rows],
    )
    faults = ", ".join(f"{n} {name}" for name, n in report.errors.items()) or "none"
    cores = "not known" if report.cpu is None else f"{report.cpu:.2f} cores"
    typer.echo(f"errors: {faults}; sent late by this program: {report.late}")
    typer.echo(
        f"processor: service {cores}, this program {report.client_cpu:.2f}; load average {report.load_after:.1f}"
    )


def _show(bars: Progress, bar: TaskID, before: float, share: float, text: str) -> None:
    bars.update(bar, completed=before + share, text=text)


def _cells(row: Row) -> tuple[str, ...]:
    ratio = "-" if row.ratio is None else f"{row.ratio:.3g}" if row.ratio < 100 else f"{row.ratio:,.0f}"
    return row.task, _duration(row.ours_us), _duration(row.peer_us), ratio, row.what, row.peer or row.note


def _duration(us: float | None) -> str:
    if us is None:
        return "-"
    value, unit = (us, "us") if us < 1e3 else (us / 1e3, "ms") if us < 1e6 else (us / 1e6, "s")
    return f"{value:.3g} {unit}" if value < 1e3 else f"{value:,.0f} {unit}"
