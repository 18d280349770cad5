"""Evaluate on the hall with repeat tracks: many cold starts a track, the source's protocol, the whole walks.

>>> from pathlib import Path
>>> from app.evaluation.kaist import KaistOptions, run_kaist
>>> print(run_kaist(KaistOptions(Path("data"), device="S9")).table())  # doctest: +SKIP
"""

from __future__ import annotations

import itertools
import json
import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from app.engine.types import MapBuildSettings, Progress
from app.evaluation.corners import CornerSummary, summarize_runs
from app.evaluation.datasets.kaist import (
    DEFAULT_FLOOR,
    SURVEY,
    TEST,
    KaistFloor,
    PublishedRuns,
    open_kaist,
    track_number,
)
from app.evaluation.datasets.walks import RecordedWalk
from app.evaluation.drivers import FieldRaster
from app.evaluation.errors import DataSetError, OptionsError
from app.evaluation.metrics import summarize
from app.evaluation.prepare import PreparedLevel, PrepareTask
from app.evaluation.protocol import Aids, Scenario, Through
from app.evaluation.repeats import Bench, Run, failures_of, first_fixes, replay_all
from app.evaluation.report import MapNote, Report
from app.evaluation.tables import layout, length_cell, percent_cell
from app.evaluation.through_engine import Engine, check_method, default_engine

SET_NAME = "kaist"
SURVEY_SETTINGS = MapBuildSettings(align=False)
"""Calibrated phones of one day along parallel lines: what differs between the lines is the field."""
HEADLINE_MAP_STEP_M = 1.0
"""Of the published settings the table shows those with this map step."""


@dataclass(frozen=True, slots=True)
class KaistOptions:
    """What to evaluate, and how.

    Attributes
    ----------
    data : Path
        Folder that holds ``kaist/``.
    floor : str
    device : str
        Only test tracks of this device: part of its name, case and blanks aside (``S9``, ``Mate20``); empty: all.
    runs : int
        Runs a track; they differ by seed.
    jobs, plots, cache, method, parameters, map_settings
        As in :class:`app.evaluation.protocol.EvaluationOptions`.
    """

    data: Path
    floor: str = DEFAULT_FLOOR
    device: str = ""
    runs: int = 100
    jobs: int = 1
    plots: Path | None = None
    cache: Path | None = None
    method: str = ""
    parameters: dict[str, object] = field(default_factory=dict)
    map_settings: MapBuildSettings = SURVEY_SETTINGS

    def __post_init__(self) -> None:
        for name in ("runs", "jobs"):
            if getattr(self, name) < 1:
                raise OptionsError(name, f"needs at least 1, got {getattr(self, name)}")


@dataclass(frozen=True, slots=True)
class KaistReport:
    """Result of a run: the report of all runs in the common form, and the source's protocol."""

    report: Report
    runs: tuple[Run, ...]
    n_runs: int
    device: str
    published: tuple[PublishedRuns, ...]

    @property
    def tracks(self) -> dict[str, list[Run]]:
        """Runs of each track, in the order of the file."""
        return _group(self.runs, lambda run: run.result.walk_id)

    @property
    def devices(self) -> dict[str, list[Run]]:
        """Runs of each device."""
        return _group(self.runs, lambda run: run.device)

    def protocol(self) -> CornerSummary:
        """The source's figures over all runs."""
        return summarize_runs([run.error_m for run in self.runs])

    def to_dict(self) -> dict[str, Any]:
        """The report as plain values."""
        return self.report.to_dict() | {
            "walks": [run.as_dict() for run in self.runs],
            "floor": self.report.levels[0],
            "device": self.device or None,
            "runs": self.n_runs,
            "protocol": self.protocol().as_dict()
            | {"tracks": {name: _protocol(runs).as_dict() for name, runs in self.tracks.items()}},
            "first_fix": first_fixes(self.runs).as_dict(),
            "tracks": {name: {"device": runs[0].device} | _figures(runs) for name, runs in self.tracks.items()},
            "devices": {name: _figures(runs) for name, runs in self.devices.items()},
            "published": [_published_figures(one, self.numbers()) for one in self.published],
        }

    def to_json(self) -> str:
        """The report as JSON text."""
        return json.dumps(self.to_dict(), allow_nan=False, separators=(",", ":"))

    def table(self) -> str:
        """One row a track, a device, all of them, and what the source published for the same tracks."""
        rows = [_HEADER, *(_row(name, runs[0].device, runs) for name, runs in self.tracks.items())]
        if len(self.devices) > 1:
            rows += [_row("all tracks", name, runs) for name, runs in self.devices.items()]
        rows.append(_row("all tracks", "all" if len(self.devices) > 1 else "", list(self.runs)))
        for one in self.published:
            if one.map_step_m == HEADLINE_MAP_STEP_M:
                rows += _published_rows(one, self.numbers())
        head = f"{SET_NAME} {self.report.levels[0]}, cold, {self.report.method}, {self.n_runs} runs a track"
        legend = [_LEGEND_CORNERS, _LEGEND_WALK, *([_LEGEND_PUBLISHED] if self.published else [])]
        lines = [head, *layout(rows, left=2), *legend]
        lines += [f"dropped: {d.walk_id} ({d.reason})" for d in self.report.dropped]
        return "\n".join([*lines, *(f"note: {note}" for note in self.report.notes)])

    def numbers(self) -> list[int]:
        """Numbers of the tracks that were run."""
        numbers = {track_number(name) for name in self.tracks}
        return sorted(number for number in numbers if number is not None)


def run_kaist(options: KaistOptions, progress: Progress | None = None, *, engine: Engine | None = None) -> KaistReport:
    """Evaluate on a floor of the ``kaist`` data set.

    Raises
    ------
    DataSetError
        The data are not there or not in the format, or no map can be built of them.
    OptionsError
        Options that cannot be honoured.
    """
    engine = engine or default_engine()
    say = progress or (lambda _fraction, _what: None)
    floor = open_kaist(options.data).floor(options.floor)
    walks = _of_device(floor, options.device)
    options = replace(options, method=options.method or engine.default_method)
    check_method(engine, options.method, options.parameters)
    engine.warm_up()
    say(0.0, "map")
    prepared = engine.prepare(_survey(floor, options))
    if prepared.grid_map is None:
        raise DataSetError(floor.folder, f"gives no map: {prepared.problem}")
    bench = Bench(
        floor.name, prepared.grid_map, prepared.area, options.method, options.parameters, engine.create_tracker
    )
    tasks = bench.tasks(walks, Scenario.COLD, options.runs)
    runs, dropped = replay_all(tasks, options.jobs, engine.warm_up, lambda f, what: say(0.1 + 0.75 * f, what))
    report = Report(
        set_name=SET_NAME,
        scenario=Scenario.COLD,
        aids=Aids(),
        through=Through.ENGINE,
        method=options.method,
        levels=(floor.name,),
        walks=tuple(run.result for run in runs),
        dropped=dropped,
        maps={floor.name: MapNote(prepared.n_walks, prepared.build_s)},
        aids_used=False,
        notes=failures_of(runs),
    )
    whole = KaistReport(report, runs, options.runs, options.device, floor.published)
    if options.plots:
        _plot(whole, floor, prepared, options.plots, lambda f, what: say(0.85 + 0.15 * f, what))
    say(1.0, "done")
    return whole


def _of_device(floor: KaistFloor, device: str) -> tuple[RecordedWalk, ...]:
    walks = floor.walks(TEST)
    chosen = tuple(walk for walk in walks if _plain(device) in _plain(walk.device))
    if not chosen:
        found = ", ".join(sorted({walk.device for walk in walks})) or "no test track"
        raise OptionsError("device", f"no test track of {device!r}; found: {found}")
    return chosen


def _plain(name: str) -> str:
    return re.sub(r"[\W_]", "", name).lower()


def _survey(floor: KaistFloor, options: KaistOptions) -> PrepareTask:
    walks = tuple(walk.survey_walk() for walk in floor.walks(SURVEY))
    return PrepareTask(floor.name, walks, options.map_settings, options.cache, vector_plan=floor.plan)


def _plot(report: KaistReport, floor: KaistFloor, prepared: PreparedLevel, folder: Path, progress: Progress) -> None:
    # matplotlib takes most of a second to import
    from app.evaluation.distributions import plot_errors
    from app.evaluation.plots import Backdrop, plot_report

    raster = None if prepared.grid_map is None else FieldRaster.of(prepared.grid_map)
    first = replace(report.report, walks=tuple(runs[0].result for runs in report.tracks.values()))
    plot_report(first, {floor.name: Backdrop(floor.extent, floor.plan_png_path, raster)}, folder, progress)
    plot_errors(report.report, folder / "errors.png")
    _plot_protocol(report, floor, folder / "protocol.png")


def _plot_protocol(report: KaistReport, floor: KaistFloor, path: Path) -> None:
    """Errors of the runs by the source's protocol, the published runs, and the best of their figures as lines."""
    from app.evaluation.distributions import COLOURS, Curve, Published, plot_curves

    own = {f"{report.report.method}, {name}": [r.error_m for r in runs] for name, runs in report.devices.items()}
    headline = [one for one in report.published if one.map_step_m == HEADLINE_MAP_STEP_M]
    theirs = {f"published {one.method}, {one.particles} particles": one.error_m.tolist() for one in headline}
    curves = [
        Curve(f"{name} ({len(errors)} runs)", [np.inf if e is None else e for e in errors], colour, thin=name in theirs)
        for (name, errors), colour in zip((own | theirs).items(), itertools.cycle(COLOURS), strict=False)
    ]
    figures = [_published_summary(one, report.numbers()) for one in headline]
    best = min((one for one in figures if one.mean_all is not None), key=lambda one: one.mean_all or 0.0, default=None)
    lines = []
    if best is not None and best.mean_all is not None and best.converged_share is not None:
        lines = [
            Published(f"mean over all runs {best.mean_all:.2f} m", length_m=best.mean_all),
            Published(f"converged {100 * best.converged_share:.0f} % of the runs", share=best.converged_share),
        ]
    plot_curves(
        curves,
        path,
        x_label="mean error of a run at its corners but the first two (m)",
        y_label="share of runs (%)",
        title=f"{SET_NAME} {floor.name}, cold, {report.n_runs} runs a track",
        published=lines,
    )


def _group(runs: Sequence[Run], key: Any) -> dict[str, list[Run]]:
    groups: dict[str, list[Run]] = {}
    for run in runs:
        groups.setdefault(key(run), []).append(run)
    return groups


def _protocol(runs: Sequence[Run]) -> CornerSummary:
    return summarize_runs([run.error_m for run in runs])


def _figures(runs: Sequence[Run]) -> dict[str, Any]:
    """Whole walks, corners and first fixes of some runs."""
    walks = [run.result for run in runs]
    covered = [walk for walk in walks if walk.covered]
    return {
        "n_runs": len(runs),
        "all": summarize([w.causal.scores for w in walks], [s for w in walks for s in w.segment_s]).as_dict(),
        "covered": summarize([w.causal.scores for w in covered], [s for w in covered for s in w.segment_s]).as_dict(),
        "protocol": _protocol(runs).as_dict(),
        "first_fix": first_fixes(runs).as_dict(),
    }


def _published_figures(one: PublishedRuns, tracks: Sequence[int]) -> dict[str, Any]:
    setting = {"method": one.method, "particles": one.particles, "map_step_m": one.map_step_m}
    pooled = _published_summary(one, tracks).as_dict()
    return setting | pooled | {"tracks": {str(track): _published_summary(one, [track]).as_dict() for track in tracks}}


def _published_summary(one: PublishedRuns, tracks: Sequence[int]) -> CornerSummary:
    rows = [number in tracks for number in one.track.tolist()]
    return summarize_runs(one.error_m[rows].tolist())


_LEGEND_CORNERS = (
    "converged, mean conv, mean all: the source's protocol (error of a run: mean at its corners but the first two; "
    "converged below 9 m; mean over converged runs, over all)"
)
_LEGEND_WALK = (
    "mean to sure<5m: every step after the first 5 s; 1st fix: metres walked until a fix claims a position (median); "
    "then: steps from it on"
)
_LEGEND_PUBLISHED = "published: the source's own runs on the same tracks (Galaxy S9, map step 1 m), N particles"
_HEADER = (
    "track", "device", "runs", "converged", "mean conv", "mean all", "mean", "p50", "p90", "p95", "end p50",
    "in 95 %", "sure", "sure<5m", "1st fix", "then p50", "then p90", "ms/seg",
)  # fmt: skip


def _row(name: str, device: str, runs: Sequence[Run]) -> tuple[str, ...]:
    corners, first = _protocol(runs), first_fixes(runs)
    walk = summarize([r.result.causal.scores for r in runs], [s for r in runs for s in r.result.segment_s])
    return (
        name,
        device,
        str(len(runs)),
        *_corner_cells(corners),
        *(length_cell(value) for value in (walk.mean, walk.p50, walk.p90, walk.p95, walk.end_p50)),
        *(percent_cell(value) for value in (walk.ellipse95, walk.sure_share, walk.sure_within_5m)),
        *(length_cell(value) for value in (first.p50_m, first.after.p50, first.after.p90)),
        length_cell(walk.ms_per_segment),
    )


def _published_rows(one: PublishedRuns, tracks: Sequence[int]) -> list[tuple[str, ...]]:
    summary = _published_summary(one, tracks)
    row = (f"published: {one.method}", f"N={one.particles}", str(summary.n_runs), *_corner_cells(summary))
    return [row + ("",) * (len(_HEADER) - len(row))]


def _corner_cells(summary: CornerSummary) -> tuple[str, ...]:
    return (
        percent_cell(summary.converged_share),
        length_cell(summary.mean_converged),
        length_cell(summary.mean_all),
    )
