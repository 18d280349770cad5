"""Run an evaluation: prepare the levels, replay the walks, write the report.

>>> from pathlib import Path
>>> from app.evaluation.protocol import EvaluationOptions
>>> report = run_ilc20(EvaluationOptions(Path("maps/samples"), limit=2))  # doctest: +SKIP
>>> print(report.table())  # doctest: +SKIP
"""

from __future__ import annotations

from dataclasses import replace

from app.engine.types import Progress
from app.evaluation.datasets.ilc20 import open_ilc20
from app.evaluation.drivers import Transport
from app.evaluation.errors import OptionsError
from app.evaluation.levels import LevelsOfRun, Outcome
from app.evaluation.protocol import EvaluationOptions, Through
from app.evaluation.replay import Results
from app.evaluation.report import MapNote, Report
from app.evaluation.results import Dropped, WalkResult
from app.evaluation.through_engine import Engine, check_method, default_engine, run_through_engine
from app.evaluation.through_http import run_through_http

SET_NAME = "ilc20"


def run_ilc20(
    options: EvaluationOptions,
    progress: Progress | None = None,
    *,
    transport: Transport | None = None,
    engine: Engine | None = None,
) -> Report:
    """Evaluate on a data set in the ilc20 folder format.

    Parameters
    ----------
    options : EvaluationOptions
    progress : callable or None
        ``progress(fraction, what)``.
    transport : Transport or None
        The service, with ``through=http``.
    engine : Engine or None
        None: the real one.

    Raises
    ------
    DataSetError
        The data are not there or not in the format.
    OptionsError
        Options that cannot be honoured.
    TransportError
        The service cannot be reached, or refuses a level, a walk, a map or a session.
    """
    if options.through is Through.HTTP and transport is None:
        raise OptionsError("through", "http needs a transport to a running service")
    engine = engine or default_engine()
    say = progress or _silent
    levels = LevelsOfRun.choose(open_ilc20(options.data), options)
    options = replace(options, method=options.method or engine.default_method)
    check_method(engine, options.method, options.parameters)
    if options.through is Through.HTTP and transport is not None:
        outcome = run_through_http(levels, options, engine, transport, say)
    else:
        outcome = run_through_engine(levels, options, engine, say)
    report = _report(options, levels, outcome)
    if options.plots:
        # matplotlib takes most of a second to import
        from app.evaluation.plots import Backdrop, plot_report

        backdrops = {
            level.name: Backdrop(level.extent, level.plan_png_path, outcome.rasters.get(level.name))
            for level in levels.evaluated
        }
        plot_report(report, backdrops, options.plots, lambda f, what: say(0.85 + 0.15 * f, what))
    say(1.0, "done")
    return report


def _report(options: EvaluationOptions, levels: LevelsOfRun, outcome: Outcome) -> Report:
    through_engine = options.through is Through.ENGINE
    unmapped = [
        Dropped(p.name, "", f"no map: {p.problem}") for p in outcome.prepared if through_engine and not p.grid_map
    ]
    return Report(
        set_name=SET_NAME,
        scenario=options.scenario,
        aids=options.aids,
        through=options.through,
        method=options.method,
        levels=tuple(level.name for level in levels.evaluated),
        walks=tuple(r for r in outcome.results if isinstance(r, WalkResult)),
        dropped=(*unmapped, *(r for r in outcome.results if isinstance(r, Dropped))),
        maps={p.name: MapNote(p.n_walks, p.build_s) for p in outcome.prepared},
        aids_used=outcome.aids_used if options.aids else False,
        notes=(*outcome.notes, *_failures(outcome.results)),
    )


def _failures(results: Results) -> tuple[str, ...]:
    """A run must not pass over segments that failed."""
    failures = [failure for result in results if isinstance(result, WalkResult) for failure in result.failures]
    return (f"{len(failures)} failures; the first: {failures[0]}",) if failures else ()


def _silent(_fraction: float, _what: str) -> None:
    return
