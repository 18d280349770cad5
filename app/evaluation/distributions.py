"""Plots of error distributions, with published figures as reference lines. Drawn off screen."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from app.evaluation.report import Report

FIXES, BASELINE, SMOOTHED = "#c2185b", "#8d8d8d", "#00796b"
"""Colours; a map's field runs from blue to yellow, so the tracks stay off that range."""
_REFERENCE = "#333333"
COLOURS = ("#c2185b", "#1565c0", "#00796b", "#ef6c00", "#6a1b9a", "#5d4037", "#558b2f", "#546e7a")
_DPI = 110
_WIDTH_IN = 9.0
_TO_M = 15.0


@dataclass(frozen=True, slots=True)
class Curve:
    """Some errors (m): where one is infinite or not known, the curve stays below 100 %."""

    label: str
    errors: ArrayLike
    colour: str
    dashed: bool = False
    thin: bool = False


@dataclass(frozen=True, slots=True)
class Published:
    """A published figure: a length (m), upright, or a share (0 to 1), level."""

    label: str
    length_m: float | None = None
    share: float | None = None


def plot_curves(
    curves: Sequence[Curve], path: Path, *, x_label: str, y_label: str, title: str, published: Sequence[Published] = ()
) -> Path:
    """Draw distributions of errors, and published figures as dotted lines."""
    figure, axes = new_figure(0.6)
    for curve in curves:
        _draw_curve(axes, curve)
    for number, one in enumerate(published):
        style = {"color": _REFERENCE, "ls": (0, (1, 1 + number)), "lw": 1.4, "label": f"published: {one.label}"}
        if one.length_m is not None:
            axes.axvline(one.length_m, **style)
        if one.share is not None:
            axes.axhline(100 * one.share, **style)
    axes.set(xlim=(0, _TO_M), ylim=(0, 100), xlabel=x_label, ylabel=y_label, title=title)
    axes.grid(color="#dddddd", lw=0.6)
    if axes.lines:
        axes.legend(loc="lower right", fontsize=8)
    return save_figure(figure, path)


def plot_errors(report: Report, path: Path, published: Sequence[Published] = ()) -> Path:
    """Draw the distribution of the errors at the steps: method, dead reckoning and smoothed; all and covered."""
    curves = []
    for covered in (False, True):
        walks = [walk for walk in report.walks if walk.covered or not covered]
        if covered and len(walks) == len(report.walks):
            continue  # the same curves once more
        tracks = (
            (report.method, FIXES, [walk.causal for walk in walks]),
            ("dead reckoning", BASELINE, [walk.baseline for walk in walks if walk.baseline]),
            ("smoothed", SMOOTHED, [walk.smoothed for walk in walks if walk.smoothed]),
        )
        group = "covered" if covered else "all"
        for name, colour, scored in tracks:
            errors = np.concatenate([np.empty(0), *(track.scores.error for track in scored)])
            known = errors[~np.isnan(errors)]
            curves.append(Curve(f"{name} ({group}, {len(scored)} walks)", known, colour, dashed=covered))
    return plot_curves(
        curves,
        path,
        x_label="horizontal error at a step (m)",
        y_label="share of steps (%)",
        title=f"{report.set_name}, {report.scenario}, aids {report.aids}, through {report.through}",
        published=published,
    )


def plot_reports(reports: Sequence[Mapping[str, Any]], path: Path) -> Path:
    """Draw several written reports side by side: errors at the steps, all and covered walks, published figures.

    A step without an answer or on the wrong level (null in a report) counts as an error without bound.
    """
    curves, published = [], []
    for number, report in enumerate(_scenarios(reports)):
        colour = COLOURS[number % len(COLOURS)]
        name = ", ".join([report["set"], report["scenario"], *([report["aids"]] if report["aids"] != "none" else [])])
        for covered in (False, True):
            walks = [walk for walk in report["walks"] if walk["covered"] or not covered]
            errors = [np.inf if error is None else error for walk in walks for error in walk["errors_m"]]
            if walks and not (covered and len(walks) == len(report["walks"])):
                group = "covered" if covered else "all"
                curves.append(Curve(f"{name} ({group}, {len(walks)} walks)", errors, colour, dashed=covered))
        published += _published_in(report)
    return plot_curves(
        curves,
        path,
        x_label="horizontal error at a step (m)",
        y_label="share of steps (%)",
        title="errors on test walks",
        published=published,
    )


def _scenarios(reports: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Reports one scenario each: that of the laboratory holds the unknown start inside the known one."""
    return [part for report in reports for part in (report, report.get("unknown_start")) if part is not None]


def _published_in(report: Mapping[str, Any]) -> list[Published]:
    """Published means: one method with and without the field, or the best of several methods over many runs."""
    figures = report.get("published") or []
    if isinstance(figures, Mapping):
        found = {"mean error": figures.get("mean"), "mean of dead reckoning": figures.get("dead_reckoning_mean")}
    else:
        best = min(
            (one for one in figures if one["mean_all"] is not None), key=lambda one: one["mean_all"], default=None
        )
        found = {} if best is None else {f"{best['method']}, mean error of a run": best["mean_all"]}
    return [
        Published(f"{report['set']}, {name} {length:.2f} m", length_m=length)
        for name, length in found.items()
        if length is not None
    ]


def _draw_curve(axes: Any, curve: Curve) -> None:
    ordered = np.sort(np.asarray(curve.errors, dtype=np.float64))
    if not len(ordered):
        return
    share = np.arange(1, len(ordered) + 1) / len(ordered)
    finite = np.isfinite(ordered)
    axes.plot(
        ordered[finite], 100 * share[finite], color=curve.colour, ls="--" if curve.dashed else "-",
        lw=1.2 if curve.thin else 1.8, label=curve.label,
    )  # fmt: skip


def new_figure(height_by_width: float) -> tuple[Any, Any]:
    """Figure and axes of the reports' size."""
    # not pyplot: that keeps every figure in global state
    height = height_by_width * _WIDTH_IN + 0.8
    figure = Figure(figsize=(_WIDTH_IN, height), dpi=_DPI, layout="constrained")
    FigureCanvasAgg(figure)
    return figure, figure.add_subplot()


def save_figure(figure: Any, path: Path) -> Path:
    """Write a figure; its folder is made."""
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path)
    return path
