"""Evaluate on the laboratory walks: start pose known, as the published run assumes, and start unknown.

>>> from pathlib import Path
>>> from app.evaluation.uji import UjiOptions, run_uji
>>> print(run_uji(UjiOptions(Path("data"))).table())  # doctest: +SKIP
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from app.engine.calibration import next_session, remember_strides, unknown_device
from app.engine.errors import InputError
from app.engine.mapping.samples import place_samples
from app.engine.types import DeviceCalibration, MapBuildSettings, Progress, SurveyWalk
from app.evaluation.datasets.uji import LEVEL, TEST, TRAIN, open_uji
from app.evaluation.drivers import FieldRaster
from app.evaluation.errors import DataSetError, OptionsError
from app.evaluation.metrics import Summary, summarize
from app.evaluation.prepare import PreparedLevel, PrepareTask
from app.evaluation.protocol import Aids, Scenario, Through
from app.evaluation.repeats import Bench, Run, failures_of, first_fixes, replay_all
from app.evaluation.report import MapNote, Report
from app.evaluation.results import Dropped
from app.evaluation.tables import layout, length_cell, percent_cell
from app.evaluation.through_engine import Engine, check_method, default_engine

SET_NAME = "uji"
PUBLISHED_MEAN_M = 4.05
"""Mean error of the published run on the 11 test walks, start pose known."""
PUBLISHED_DEAD_RECKONING_MEAN_M = 4.46
"""The same without the field."""


@dataclass(frozen=True, slots=True)
class UjiOptions:
    """What to evaluate, and how.

    Attributes
    ----------
    data : Path
        Folder that holds ``uji/``.
    runs : int
        Runs a walk; they differ by seed.
    jobs, plots, cache, method, parameters, map_settings
        As in :class:`app.evaluation.protocol.EvaluationOptions`.
    """

    data: Path
    runs: int = 10
    jobs: int = 1
    plots: Path | None = None
    cache: Path | None = None
    method: str = ""
    parameters: dict[str, object] = field(default_factory=dict)
    map_settings: MapBuildSettings = field(default_factory=MapBuildSettings)

    def __post_init__(self) -> None:
        for name in ("runs", "jobs"):
            if getattr(self, name) < 1:
                raise OptionsError(name, f"needs at least 1, got {getattr(self, name)}")


@dataclass(frozen=True, slots=True)
class ScenarioReport:
    """All runs of one scenario: the report in the common form, and the figures over whole walks."""

    report: Report
    runs: tuple[Run, ...]

    def whole(self) -> Summary:
        """Errors at every step from the first label on."""
        return summarize([run.whole for run in self.runs])

    def whole_dead_reckoning(self) -> Summary:
        """The same of dead reckoning, where it had a start."""
        return summarize([run.whole_baseline for run in self.runs if run.whole_baseline])

    def to_dict(self) -> dict[str, Any]:
        """The report as plain values."""
        return self.report.to_dict() | {
            "walks": [run.as_dict() for run in self.runs],
            "whole": self.whole().as_dict(),
            "whole_dead_reckoning": self.whole_dead_reckoning().as_dict(),
            "first_fix": first_fixes(self.runs).as_dict(),
        }


@dataclass(frozen=True, slots=True)
class UjiReport:
    """Result of a run."""

    pose: ScenarioReport
    cold: ScenarioReport
    n_runs: int

    def to_dict(self) -> dict[str, Any]:
        """The report as plain values: the known start at the top, the unknown one below ``unknown_start``."""
        return self.pose.to_dict() | {
            "runs": self.n_runs,
            "published": {"mean": PUBLISHED_MEAN_M, "dead_reckoning_mean": PUBLISHED_DEAD_RECKONING_MEAN_M},
            "unknown_start": self.cold.to_dict(),
        }

    def to_json(self) -> str:
        """The report as JSON text."""
        return json.dumps(self.to_dict(), allow_nan=False, separators=(",", ":"))

    def table(self) -> str:
        """One row a walk and all of them: start known and unknown, dead reckoning, the published figures."""
        names = list(dict.fromkeys(run.result.walk_id for run in self.pose.runs))
        rows: list[tuple[str, ...]] = [_HEADER]
        for name in names:
            both = [[run for run in one.runs if run.result.walk_id == name] for one in (self.pose, self.cold)]
            rows.append(_row(name, *both))
        rows.append(_row(f"all {len(names)}", self.pose.runs, self.cold.runs))
        rows.append(("published", *[""] * 2, length_cell(PUBLISHED_MEAN_M), *[""] * 6, *_PUBLISHED_REST))
        head = f"{SET_NAME}, {self.pose.report.method}, {self.n_runs} runs a walk"
        lines = [head, *layout(rows, left=1), *_LEGEND]
        reports = (self.pose.report, self.cold.report)
        lines += [f"dropped: {d.walk_id} ({d.reason})" for d in reports[0].dropped]
        return "\n".join([*lines, *(f"note: {note}" for report in reports for note in report.notes)])


def run_uji(options: UjiOptions, progress: Progress | None = None, *, engine: Engine | None = None) -> UjiReport:
    """Evaluate on the ``uji`` data set.

    Raises
    ------
    DataSetError
        The data are not there or not in the format, or no map can be built of them.
    OptionsError
        Options that cannot be honoured.
    """
    engine = engine or default_engine()
    say = progress or (lambda _fraction, _what: None)
    data = open_uji(options.data)
    options = replace(options, method=options.method or engine.default_method)
    check_method(engine, options.method, options.parameters)
    engine.warm_up()
    say(0.0, "map")
    survey = tuple(walk.survey_walk() for walk in data.walks(*TRAIN))
    prepared = engine.prepare(PrepareTask(LEVEL, survey, options.map_settings, options.cache))
    if prepared.grid_map is None:
        raise DataSetError(data.folder, f"gives no map: {prepared.problem}")
    bench = Bench(
        LEVEL, prepared.grid_map, prepared.area, options.method, options.parameters, engine.create_tracker,
        calibration=known_device(survey),
    )  # fmt: skip
    walks = data.walks(TEST)

    def replayed(scenario: Scenario, start: float) -> ScenarioReport:
        tasks = bench.tasks(walks, scenario, options.runs)
        runs, dropped = replay_all(
            tasks, options.jobs, engine.warm_up, lambda f, what: say(start + 0.4 * f, f"{scenario}: {what}")
        )
        return ScenarioReport(_report(scenario, options.method, prepared, runs, dropped), runs)

    whole = UjiReport(replayed(Scenario.POSE, 0.1), replayed(Scenario.COLD, 0.5), options.runs)
    if options.plots:
        _plot(whole, prepared, options.plots)
    say(1.0, "done")
    return whole


def known_device(survey: Sequence[SurveyWalk]) -> DeviceCalibration:
    """What the survey taught about its phone by the time of the test walks: the carrier's stride.

    The data set has one phone and the same walkers throughout; a service knows as much of a device that surveyed. Its
    magnetometer was recalibrated again and again, by 12 uT of the vertical field (one standard deviation over the
    survey's walks), so of its hard iron nothing is known.
    """
    scales = [scale for walk in survey if (scale := _stride_scale(walk)) is not None]
    return next_session(remember_strides(unknown_device(), scales))


def _stride_scale(walk: SurveyWalk) -> float | None:
    try:
        return place_samples(walk).stride_scale
    except InputError:  # the map is built without it, too
        return None


def _report(
    scenario: Scenario, method: str, prepared: PreparedLevel, runs: Sequence[Run], dropped: tuple[Dropped, ...]
) -> Report:
    return Report(
        set_name=SET_NAME,
        scenario=scenario,
        aids=Aids(),
        through=Through.ENGINE,
        method=method,
        levels=(LEVEL,),
        walks=tuple(run.result for run in runs),
        dropped=dropped,
        maps={LEVEL: MapNote(prepared.n_walks, prepared.build_s)},
        aids_used=False,
        notes=failures_of(runs),
    )


def _plot(report: UjiReport, prepared: PreparedLevel, folder: Path) -> None:
    # matplotlib takes most of a second to import
    from app.evaluation.distributions import Published, plot_errors
    from app.evaluation.plots import Backdrop, plot_report

    if prepared.grid_map is None:
        return
    backdrop = Backdrop(prepared.grid_map.extent, None, FieldRaster.of(prepared.grid_map))
    lines = (
        Published(f"mean error {PUBLISHED_MEAN_M:.2f} m", length_m=PUBLISHED_MEAN_M),
        Published(
            f"mean error of dead reckoning {PUBLISHED_DEAD_RECKONING_MEAN_M:.2f} m",
            length_m=PUBLISHED_DEAD_RECKONING_MEAN_M,
        ),
    )
    for one in (report.pose, report.cold):
        first = tuple(run.result for run in one.runs if run.number == 0)
        below = folder / one.report.scenario.value
        plot_report(replace(one.report, walks=first), {LEVEL: backdrop}, below, lambda _fraction, _what: None)
        if one.runs:
            # what was published assumes the start pose
            plot_errors(one.report, below / "errors.png", lines if one is report.pose else ())


_HEADER = (
    "walk", "length", "runs", "mean", "p50", "p90", "end p50", "in 95 %", "sure", "sure<5m", "dr mean",
    "unknown: mean", "p50", "p90", "end p50", "in 95 %", "sure", "sure<5m", "1st fix",
)  # fmt: skip
_PUBLISHED_REST = (length_cell(PUBLISHED_DEAD_RECKONING_MEAN_M), *[""] * 8)
_LEGEND = (
    "start pose known, then unknown; strides known from the survey; dr: dead reckoning",
    "errors in metres at every step from the first label on",
    "1st fix: metres walked until a fix claims a position (median); published: its run assumes the start pose",
)


def _row(name: str, pose: Sequence[Run], cold: Sequence[Run]) -> tuple[str, ...]:
    lengths = {run.result.walk_id: run.result.length_m for run in pose}
    baseline = summarize([run.whole_baseline for run in pose if run.whole_baseline])
    return (
        name,
        f"{sum(lengths.values()):.0f} m",
        str(len(pose)),
        *_cells(pose),
        length_cell(baseline.mean),
        *_cells(cold),
        length_cell(first_fixes(cold).p50_m),
    )


def _cells(runs: Sequence[Run]) -> tuple[str, ...]:
    own = summarize([run.whole for run in runs])
    lengths = (own.mean, own.p50, own.p90, own.end_p50)
    shares = (own.ellipse95, own.sure_share, own.sure_within_5m)
    return (*(length_cell(value) for value in lengths), *(percent_cell(value) for value in shares))
