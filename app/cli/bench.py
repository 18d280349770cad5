"""``isodyn bench``: how fast the numerics and the store are on this machine."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from app.cli.common import NAMED, print_table, progress_bars, reported

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
