"""Plots: one per walk over the floor plan. Drawn off screen."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.colors import to_rgb
from matplotlib.image import imread
from matplotlib.patches import Ellipse

from app.engine.types import Fix, Float64Array, Progress, Status
from app.evaluation.distributions import BASELINE, FIXES, SMOOTHED, new_figure, plot_errors, save_figure
from app.evaluation.drivers import FieldRaster
from app.evaluation.metrics import ELLIPSE95, summarize
from app.evaluation.report import Report
from app.evaluation.results import ScoredTrack, WalkResult

TRUTH = "#111111"
_FIELD_COLOURS = "viridis"
_MARGIN_M = 8.0
_SHORTEST_SIDE_M = 30.0
_FLATTEST, _TALLEST = 0.45, 1.25
"""Height of a plot over its width."""
_ELLIPSE_EVERY_M = 4.0


@dataclass(frozen=True, slots=True)
class Backdrop:
    """What lies under the tracks of a level: plan image (its edges are ``extent``) and map field."""

    extent: tuple[float, float, float, float]
    plan_png: Path | None = None
    field: FieldRaster | None = None


def plot_report(report: Report, backdrops: Mapping[str, Backdrop], folder: Path, progress: Progress) -> list[Path]:
    """Write ``<level>/<walk>.png`` for each walk and ``errors.png``; returns the paths."""
    paths = []
    for number, walk in enumerate(report.walks, start=1):
        path = folder / walk.level / f"{_file_name(walk.walk_id)}.png"
        paths.append(plot_walk(walk, backdrops[walk.level], path, method=report.method))
        progress(number / (len(report.walks) + 1), f"plot {number} of {len(report.walks)}")
    if report.walks:
        paths.append(plot_errors(report, folder / "errors.png"))
    return paths


def plot_walk(walk: WalkResult, backdrop: Backdrop, path: Path, *, method: str = "fixes") -> Path:
    """Draw one walk: map field, truth, dead reckoning, fixes with their 95 % ellipses, smoothed track."""
    view = _view(walk)
    figure, axes = new_figure((view[3] - view[1]) / (view[2] - view[0]))
    _draw_backdrop(figure, axes, backdrop)
    if walk.baseline:
        x, y = _columns(walk.baseline.fixes)
        axes.plot(x, y, color=BASELINE, lw=1.6, ls="--", zorder=4, label=_label("dead reckoning", walk.baseline))
    axes.plot(walk.truth.x, walk.truth.y, color=TRUTH, lw=2.2, zorder=5, label=f"truth ({walk.length_m:.0f} m)")
    axes.plot(
        walk.waypoints.x, walk.waypoints.y, color=TRUTH, ls="none", marker="s", ms=5, mfc="white", zorder=6,
        label="labelled waypoints",
    )  # fmt: skip
    if walk.smoothed:
        x, y = _columns(walk.smoothed.fixes)
        axes.plot(x, y, color=SMOOTHED, lw=1.8, zorder=7, label=_label("smoothed", walk.smoothed))
    _draw_fixes(axes, walk, method)
    if walk.prior.x is not None and walk.prior.y is not None:
        axes.plot(walk.prior.x, walk.prior.y, color=FIXES, marker="x", ms=9, mew=2, ls="none", zorder=9, label="prior")
    axes.set(xlim=(view[0], view[2]), ylim=(view[1], view[3]), xlabel="x (m)", ylabel="y (m)", aspect="equal")
    inside = summarize([walk.causal.scores]).ellipse95
    said = "-" if inside is None else f"{100 * inside:.0f} %"
    axes.set_title(
        f"{walk.level}  {walk.walk_id}\ntruth inside the 95 % ellipse: {said} of steps · "
        f"{100 * walk.covered_share:.0f} % of the walk surveyed",
        fontsize=10, loc="left",
    )  # fmt: skip
    # below the plan: inside it would hide some walk
    figure.legend(loc="outside lower center", ncols=3, fontsize=8, frameon=False)
    return save_figure(figure, path)


def _draw_backdrop(figure: Any, axes: Any, backdrop: Backdrop) -> None:
    x_min, y_min, x_max, y_max = backdrop.extent
    if backdrop.plan_png:
        plan = imread(backdrop.plan_png)
        axes.imshow(plan, extent=(x_min, x_max, y_min, y_max), alpha=0.35, zorder=1, interpolation="bilinear")
    if backdrop.field is None:
        return
    field = backdrop.field
    rows, columns = field.values.shape
    half = field.cell_m / 2
    image = axes.imshow(
        np.ma.masked_invalid(field.values),
        extent=(
            field.x0 - half, field.x0 + (columns - 0.5) * field.cell_m,
            field.y0 - half, field.y0 + (rows - 0.5) * field.cell_m,
        ),
        origin="lower", cmap=_FIELD_COLOURS, alpha=0.6, zorder=2, interpolation="nearest",
    )  # fmt: skip
    bar = figure.colorbar(image, cax=axes.inset_axes((1.015, 0.0, 0.02, 1.0)))
    bar.set_label(f"field magnitude in the map ({field.unit})", fontsize=8)
    bar.ax.tick_params(labelsize=7)


def _draw_fixes(axes: Any, walk: WalkResult, method: str) -> None:
    # fixes on another level lie on another plan
    fixes = tuple(fix for fix in walk.causal.fixes if fix.level_id == walk.level_id)
    x, y = _columns(fixes)
    axes.plot(x, y, color=FIXES, lw=0.8, alpha=0.7, zorder=8)
    claimed = np.array([fix.status is not Status.INSUFFICIENT for fix in fixes], dtype=bool)
    axes.plot(
        x[claimed], y[claimed], color=FIXES, ls="none", marker="o", ms=3.5, zorder=8,
        label=_label(f"{method}, 95 % ellipses", walk.causal),
    )  # fmt: skip
    if (~claimed).any():
        axes.plot(
            x[~claimed], y[~claimed], color=FIXES, ls="none", marker="o", ms=4, mfc="white", zorder=8,
            label="fix that claims no position",
        )  # fmt: skip
    last: tuple[float, float] | None = None
    for fix in fixes:
        # one ellipse every few metres: all of them would hide the map
        if last and math.hypot(fix.x - last[0], fix.y - last[1]) < _ELLIPSE_EVERY_M:
            continue
        last = (fix.x, fix.y)
        ellipse = ellipse95(fix)
        if ellipse:
            axes.add_patch(ellipse)


def ellipse95(fix: Fix) -> Any | None:
    """The fix's 95 % ellipse as a patch; None if its covariance is not positive."""
    covariance = np.array([[fix.cov_xx, fix.cov_xy], [fix.cov_xy, fix.cov_yy]])
    if not np.isfinite(covariance).all():
        return None
    values, vectors = np.linalg.eigh(covariance)
    if values[0] <= 0:
        return None
    minor, major = 2.0 * np.sqrt(ELLIPSE95 * values)
    angle = math.degrees(math.atan2(vectors[1, 1], vectors[0, 1]))
    return Ellipse(
        (fix.x, fix.y),
        major,
        minor,
        angle=angle,
        fc=(*to_rgb(FIXES), 0.05),
        ec=(*to_rgb(FIXES), 0.75),
        lw=0.8,
        zorder=3,
    )


def _label(name: str, track: ScoredTrack) -> str:
    summary = summarize([track.scores])
    return name if summary.p50 is None else f"{name} (p50 {summary.p50:.1f} m, p90 {summary.p90:.1f} m)"


def _columns(fixes: tuple[Fix, ...]) -> tuple[Float64Array, Float64Array]:
    return np.array([fix.x for fix in fixes]), np.array([fix.y for fix in fixes])


def _view(walk: WalkResult) -> tuple[float, float, float, float]:
    """What to show: truth and fixes with a margin, not too narrow; a runaway baseline is cut off."""
    fix_x, fix_y = _columns(tuple(fix for fix in walk.causal.fixes if fix.level_id == walk.level_id))
    x = np.concatenate((walk.truth.x, walk.waypoints.x, fix_x))
    y = np.concatenate((walk.truth.y, walk.waypoints.y, fix_y))
    x_low, x_high, y_low, y_high = x.min(), x.max(), y.min(), y.max()
    width, height = (max(side + 2 * _MARGIN_M, _SHORTEST_SIDE_M) for side in (x_high - x_low, y_high - y_low))
    width, height = max(width, height / _TALLEST), max(height, width * _FLATTEST)
    x_mid, y_mid = (x_low + x_high) / 2, (y_low + y_high) / 2
    return (x_mid - width / 2, y_mid - height / 2, x_mid + width / 2, y_mid + height / 2)


def _file_name(walk_id: str) -> str:
    return re.sub(r"[^\w.-]", "_", walk_id)
