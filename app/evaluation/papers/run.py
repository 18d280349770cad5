"""Run the protocols of the papers.

>>> from pathlib import Path
>>> from app.evaluation.papers.run import PapersOptions, run_papers
>>> print(run_papers(PapersOptions(Path("data"), only=("s4",))).table())  # doctest: +SKIP
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

from app.engine.types import Progress
from app.evaluation.errors import OptionsError
from app.evaluation.papers.anomalies import AnomalySettings
from app.evaluation.papers.matching import part_of
from app.evaluation.papers.report import PapersReport
from app.evaluation.papers.s1 import run_s1
from app.evaluation.papers.s3 import run_s3
from app.evaluation.papers.s4 import run_s4

PAPERS = ("s1", "s3", "s4")


@dataclass(frozen=True, slots=True)
class PapersOptions:
    """What to evaluate, and how.

    Attributes
    ----------
    data : Path
        Folder that holds ``aero/`` (for ``s4``), ``uji/`` and ``kaist/`` (``s1``; ``s3`` needs ``uji/``).
    only : tuple of str
        Some of ``s1``, ``s3``, ``s4``; empty: all.
    tracks : int
        Tracks a region, windows a data set and length, simulated walks.
    jobs : int
    plots, cache : Path or None
        As in :class:`app.evaluation.protocol.EvaluationOptions`.
    anomalies : AnomalySettings
        How surveys become maps.
    """

    data: Path
    only: tuple[str, ...] = ()
    tracks: int = 100
    jobs: int = 1
    plots: Path | None = None
    cache: Path | None = None
    anomalies: AnomalySettings = field(default_factory=AnomalySettings)

    def __post_init__(self) -> None:
        for name in ("tracks", "jobs"):
            if getattr(self, name) < 1:
                raise OptionsError(name, f"needs at least 1, got {getattr(self, name)}")
        unknown = [name for name in self.only if name not in PAPERS]
        if unknown:
            raise OptionsError("only", f"knows {', '.join(PAPERS)}, not {', '.join(unknown)}")


def run_papers(options: PapersOptions, progress: Progress | None = None) -> PapersReport:
    """Put the registered matchers through the protocols; those not registered are left out, with a note.

    Raises
    ------
    DataSetError
        Data that a paper needs are not there or not in the format.
    """
    say = progress or (lambda _fraction, _what: None)
    asked = [name for name in ("s4", "s1", "s3") if name in (options.only or PAPERS)]
    report = PapersReport()
    share = 0.95 / len(asked)
    for number, name in enumerate(asked):
        report = _with(report, name, options, part_of(say, share * number, share, name))
    if options.plots:
        from app.evaluation.papers.plots import plot_papers  # matplotlib takes most of a second to import

        say(0.95, "plots")
        plot_papers(report, options.plots)
    say(1.0, "done")
    return report


def _with(report: PapersReport, name: str, options: PapersOptions, progress: Progress) -> PapersReport:
    tracks, jobs, cache = options.tracks, options.jobs, options.cache
    if name == "s4":
        regions = run_s4(options.data, options.anomalies, tracks=tracks, jobs=jobs, cache=cache, progress=progress)
        none = () if regions[0].outcomes else ("s4: no method in the registry suits an area and the total field",)
        return replace(report, s4=regions, notes=report.notes + none)
    if name == "s1":
        windows, notes = run_s1(options.data, tracks=tracks, jobs=jobs, cache=cache, progress=progress)
        return replace(report, s1=windows, notes=report.notes + _of(name, notes))
    voting, aided, notes = run_s3(options.data, tracks=tracks, jobs=jobs, cache=cache, progress=progress)
    return replace(report, voting=voting, aided=aided, notes=report.notes + _of(name, notes))


def _of(name: str, notes: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(f"{name}: {note}" for note in notes)
