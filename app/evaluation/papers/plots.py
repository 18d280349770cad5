"""Plots over the papers: the regions with one track each, and the distributions of errors. Drawn off screen."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from app.evaluation.distributions import BASELINE, COLOURS, Curve, Published, new_figure, plot_curves, save_figure
from app.evaluation.papers import published
from app.evaluation.papers.report import PapersReport
from app.evaluation.papers.s1 import METHODS, WindowResult, end_errors
from app.evaluation.papers.s3 import DeclinationResult, indicated_errors
from app.evaluation.papers.s4 import FAILED_M, RegionResult
from app.evaluation.plots import TRUTH

_NT = 1000.0


def plot_papers(report: PapersReport, folder: Path) -> list[Path]:
    """Write the plots of all papers in the report; returns their paths."""
    regions = [region for region in report.s4 or () if region.trials]
    paths = [plot_region(region, folder / "s4" / f"{region.name}.png") for region in regions]
    if report.s4 and any(region.outcomes for region in report.s4):
        paths.append(_plot_region_errors(report.s4, folder / "s4" / "errors.png"))
    if report.s1:
        paths.append(_plot_windows(report.s1, folder / "s1" / "windows.png"))
    if report.voting:
        curves = [_curve(one.name, [o.error for o in one.outcomes], i) for i, one in enumerate(report.voting)]
        bound = Published(f"97.7 % below {published.S3_VOTING['bound_m']} m", length_m=published.S3_VOTING["bound_m"])
        paths.append(_errors(curves, folder / "s3" / "voting.png", "s3, part 1: voting without odometry", [bound]))
    if report.aided:
        share = published.S3_DECLINATION["within_1m"]
        lines = [Published(f"{100 * share:.1f} % within 1 m", length_m=1.0, share=share)]
        curves = [curve for i, one in enumerate(report.aided) for curve in _aided_curves(one, i)]
        paths.append(_errors(curves, folder / "s3" / "declination.png", "s3, part 2: headings by the map", lines))
    return paths


def plot_region(region: RegionResult, path: Path, *, number: int = 0) -> Path:
    """Draw a region's field, a track, what the inertial navigation system indicates, and where methods put it."""
    trial, grid_map = region.trials[number], region.ground.grid_map
    x_min, y_min, x_max, y_max = grid_map.extent
    figure, axes = new_figure(0.85 * (y_max - y_min) / (x_max - x_min))
    extent = tuple(value / 1000.0 for value in (x_min, x_max, y_min, y_max))
    image = axes.imshow(_NT * grid_map.mean[0], origin="lower", extent=extent, cmap="viridis", alpha=0.8)
    figure.colorbar(image, ax=axes, shrink=0.7, label="anomaly of the total field (nT)")
    axes.contour(_NT * grid_map.mean[0], levels=20, extent=extent, colors="white", linewidths=0.3)
    for part in region.ground.stretches if region.n_lines else ():
        axes.plot(*(part.xy / 1000.0).T, color="white", lw=0.8, ls=":")
    track = trial.problem.track
    _draw(axes, trial.x, trial.y, TRUTH, "truth", lw=2.6)
    _draw(axes, track.x, track.y, BASELINE, "indicated", ls="--")
    for i, (method, outcomes) in enumerate(region.outcomes.items()):
        outcome = outcomes[number]
        if outcome.x is not None and outcome.y is not None:
            label = f"{method} ({outcome.status}, {outcome.error:.0f} m)"
            _draw(axes, outcome.x, outcome.y, COLOURS[i % len(COLOURS)], label, ls="-" if i < len(COLOURS) else ":")
    axes.set(xlim=extent[:2], ylim=extent[2:], xlabel="x (km)", ylabel="y (km)", aspect="equal")
    axes.set_title(f"s4, {region.name} ({region.ground.window.survey.name}), track {number}", fontsize=10, loc="left")
    figure.legend(loc="outside lower center", ncols=3, fontsize=8, frameon=False)
    return save_figure(figure, path)


def _draw(axes: Any, x: ArrayLike, y: ArrayLike, colour: str, label: str, *, lw: float = 1.5, ls: str = "-") -> None:
    x, y = np.asarray(x) / 1000.0, np.asarray(y) / 1000.0
    axes.plot(x, y, color=colour, lw=lw, ls=ls, label=label)
    axes.plot(x[-1:], y[-1:], color=colour, marker="o", ms=4)


def _plot_region_errors(regions: Sequence[RegionResult], path: Path) -> Path:
    """Distribution of the end's error, one panel a region."""
    figure, _ = new_figure(0.9)
    figure.clear()
    for number, region in enumerate(regions):
        axes = figure.add_subplot(2, -(-len(regions) // 2), number + 1)
        for i, (method, outcomes) in enumerate(region.outcomes.items()):
            errors = np.sort([outcome.error for outcome in outcomes])
            share = 100.0 * np.arange(1, len(errors) + 1) / max(len(errors), 1)
            ls = "-" if i < len(COLOURS) else ":"
            label = method if number == 0 else None
            axes.plot(errors / 1000.0, share, color=COLOURS[i % len(COLOURS)], ls=ls, lw=1.5, label=label)
        axes.axvline(FAILED_M / 1000.0, color=TRUTH, lw=0.8, ls=":")
        for i, (method, p) in enumerate(published.S4.get(region.name, {}).items()):
            mean = float(np.hypot(p["north"], p["east"])) / 1000.0
            axes.plot([mean], [50 + 4 * i], marker="v", color=TRUTH, ls="none", ms=5)
            axes.annotate(
                f"paper: {method}", (mean, 50 + 4 * i), fontsize=7, xytext=(4, -2), textcoords="offset points"
            )
        axes.set(xlim=(0, 3), ylim=(0, 100), title=region.name, xlabel="error of the end (km)", ylabel="tracks (%)")
        axes.grid(color="#dddddd", lw=0.6)
    figure.legend(loc="outside lower center", ncols=4, fontsize=8, frameon=False)
    return save_figure(figure, path)


def _plot_windows(results: Sequence[WindowResult], path: Path) -> Path:
    """Mean error by length of the window, one panel a data set, with the paper's means."""
    figure, _ = new_figure(0.5)
    figure.clear()
    names = list(dict.fromkeys(result.name for result in results))
    for number, name in enumerate(names):
        axes = figure.add_subplot(1, len(names), number + 1)
        own = [result for result in results if result.name == name]
        for i, method in enumerate(METHODS):
            points = _means(own, method)
            label = method if number == 0 else None
            axes.plot(list(points), list(points.values()), color=COLOURS[i], marker="o", label=label)
            theirs = {count: means[method] for count, means in published.S1_MEAN.items() if method in means}
            label = f"paper: {method}" if number == 0 and theirs else None
            axes.plot(list(theirs), list(theirs.values()), color=COLOURS[i], ls=":", marker="x", label=label)
        axes.set(title=name, xlabel="readings of a window", ylabel="mean error (m)")
        axes.set_ylim(bottom=0.0)
        axes.grid(color="#dddddd", lw=0.6)
    figure.legend(loc="outside lower center", ncols=4, fontsize=8, frameon=False)
    return save_figure(figure, path)


def _means(results: Sequence[WindowResult], method: str) -> Mapping[int, float]:
    found = {}
    for result in results:
        errors = end_errors(result.outcomes.get(method, ()))
        if np.isfinite(errors).any():
            found[result.window] = float(errors[np.isfinite(errors)].mean())
    return found


def _aided_curves(result: DeclinationResult, number: int) -> list[Curve]:
    before = np.concatenate([indicated_errors(trial) for trial in result.trials])
    after = np.concatenate([np.empty(0), *(outcome.track_error for outcome in result.outcomes)])
    colour = COLOURS[number]
    return [
        Curve(f"{result.name}, compass alone", before, colour, dashed=True),
        Curve(f"{result.name}, by the map", after, colour),
    ]


def _curve(name: str, errors: Sequence[float], number: int) -> Curve:
    return Curve(f"{name} ({len(errors)} windows)", errors, COLOURS[number])


def _errors(curves: Sequence[Curve], path: Path, title: str, lines: Sequence[Published]) -> Path:
    return plot_curves(curves, path, x_label="error (m)", y_label="share (%)", title=title, published=lines)
