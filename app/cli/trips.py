"""Recorded walks as sessions of a service, scored against their labels."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from app.cli.transport import ServiceTransport
from app.engine.types import Progress
from app.evaluation.datasets.ilc20 import Ilc20Level, RecordedWalk
from app.evaluation.drivers import HttpDriver
from app.evaluation.metrics import summarize
from app.evaluation.plots import Backdrop, plot_report
from app.evaluation.prepare import surveyed_area
from app.evaluation.protocol import Aids, Scenario, Through
from app.evaluation.replay import Job, replay_walks
from app.evaluation.report import Report
from app.evaluation.results import BASELINE, Dropped, WalkResult
from app.evaluation.run import SET_NAME
from app.evaluation.tables import layout

_ID_LENGTH = 8
_HEADER = ("walk", "length", "fixes", "p50", "p90", "dr p50", "dr p90", "in 95 %", "covered", "ms")
_LEGEND = """
p50, p90   error of the fixes in metres, at every step after the first 5 s
dr         dead reckoning from the same start: steps and gyroscope, no map
in 95 %    share of the steps at which the truth lies inside the 95 % ellipse
covered    share of the walk with a survey sample within 1 m
ms         milliseconds per 5-s segment, HTTP and database included"""


def replay_trips(
    transport: ServiceTransport,
    data: Ilc20Level,
    level_id: str,
    walks: Sequence[RecordedWalk],
    *,
    method: str,
    done: Callable[[RecordedWalk], None],
) -> Report:
    """Replay walks one after the other, dead reckoning beside each.

    Parameters
    ----------
    transport : ServiceTransport
    data : Ilc20Level
        Where the walks come from; its train walks tell which part of the level is surveyed.
    level_id : str
        The level of the service.
    walks : sequence of RecordedWalk
    method : str
        Empty: the service's default.
    done : callable
        Told of each walk when it is through.
    """
    area = surveyed_area([walk.survey_walk() for walk in data.walks("train")])
    driver = HttpDriver(transport, method, {})
    baseline = HttpDriver(transport, BASELINE, {})
    results: list[WalkResult | Dropped] = []
    for walk in walks:
        job = Job(data.name, level_id, "", (walk,), area, Scenario.TRACKING, Aids(), repeat=0)
        results += replay_walks(job, driver, baseline)
        done(walk)
    return Report(
        set_name=SET_NAME,
        scenario=Scenario.TRACKING,
        aids=Aids(),
        through=Through.HTTP,
        method=method or "isodyn",
        levels=(data.name,),
        walks=tuple(result for result in results if isinstance(result, WalkResult)),
        dropped=tuple(result for result in results if isinstance(result, Dropped)),
    )


def plot_trips(
    transport: ServiceTransport, data: Ilc20Level, level_id: str, report: Report, folder: Path, progress: Progress
) -> list[Path]:
    """One plot a walk over plan and map field, and the distribution of the errors."""
    backdrop = Backdrop(data.extent, data.plan_png_path, transport.field_raster(level_id))
    return plot_report(report, {data.name: backdrop}, folder, progress)


def walk_table(report: Report) -> str:
    """One row a walk, narrow enough for any terminal; walks by the start of their id, as ``--walk`` takes it."""
    rows: list[tuple[str, ...]] = [_HEADER]
    length = _telling_length([walk.walk_id for walk in report.walks])
    for walk in report.walks:
        own = summarize([walk.causal.scores], walk.segment_s)
        base = summarize([walk.baseline.scores] if walk.baseline else [])
        rows.append(
            (
                walk.walk_id[:length],
                f"{walk.length_m:.0f} m",
                str(len(walk.causal.fixes)),
                *(_metres(value) for value in (own.p50, own.p90, base.p50, base.p90)),
                _share(own.ellipse95),
                _share(walk.covered_share),
                "-" if own.ms_per_segment is None else f"{own.ms_per_segment:.0f}",
            )
        )
    return "\n".join([*layout(rows, left=1), _LEGEND])


def verdict(report: Report) -> str:
    """The walks together, in a sentence or two."""
    own, base = report.summary(), report.baseline_summary()
    if own.p50 is None or own.p90 is None:
        return "no walk was long enough to be scored"
    text = f"all {own.n_walks} walks: error {own.p50:.1f} m (p50), {own.p90:.1f} m (p90)"
    if base.p50 is not None and base.p90 is not None:
        text += f"; dead reckoning {base.p50:.1f} m, {base.p90:.1f} m"
    covered = report.summary(covered=True)
    if covered.p50 is not None and covered.p90 is not None:
        text += f"\nthe {covered.n_walks} where the survey went: {covered.p50:.1f} m, {covered.p90:.1f} m"
    if own.ellipse95 is not None:
        text += f"\ntruth inside the 95 % ellipse at {100 * own.ellipse95:.0f} % of the steps"
    return text


def _telling_length(ids: Sequence[str]) -> int:
    """How much of the ids tells them apart."""
    length = _ID_LENGTH
    while len({one[:length] for one in ids}) < len(set(ids)):
        length += 1
    return length


def _metres(value: float | None) -> str:
    return "-" if value is None else f"{value:.1f}"


def _share(value: float | None) -> str:
    return "-" if value is None else f"{100 * value:.0f} %"
