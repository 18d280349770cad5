"""Error distributions: what counts, and where published figures stand."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from app.evaluation import distributions
from app.evaluation.distributions import Curve, Published, plot_curves, plot_reports


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Axes of the figures saved."""
    axes: list[Any] = []
    save = distributions.save_figure

    def remember(figure: Any, path: Path) -> Path:
        axes.append(figure.axes[0])
        return save(figure, path)

    monkeypatch.setattr(distributions, "save_figure", remember)
    return axes


def lines(axes: Any) -> dict[str, tuple[list[float], list[float]]]:
    return {line.get_label(): (list(line.get_xdata()), list(line.get_ydata())) for line in axes.lines}


def written(scenario: str, *walks: tuple[bool, list[float | None]], **more: Any) -> dict[str, Any]:
    shown = [{"covered": covered, "errors_m": errors} for covered, errors in walks]
    return {"set": "ilc20", "scenario": scenario, "aids": "none", "walks": shown, **more}


def draw(curves: list[Curve], path: Path, *published: Published) -> Path:
    return plot_curves(curves, path, x_label="m", y_label="%", title="t", published=published)


def test_what_has_no_bound_keeps_a_curve_below_the_top(tmp_path: Path, drawn: list[Any]) -> None:
    path = draw([Curve("some", [3.0, math.inf, 1.0, 2.0], "red"), Curve("none", [], "blue")], tmp_path / "a" / "x.png")
    assert path.stat().st_size > 5000
    assert lines(drawn[0]) == {"some": ([1.0, 2.0, 3.0], [25.0, 50.0, 75.0])}


def test_published_figures_are_lines(tmp_path: Path, drawn: list[Any]) -> None:
    draw([], tmp_path / "x.png", Published("mean 1.75 m", length_m=1.75), Published("98 %", share=0.98))
    found = lines(drawn[0])
    assert found["published: mean 1.75 m"][0] == [1.75, 1.75]
    assert found["published: 98 %"][1] == [98.0, 98.0]


def test_reports_stand_side_by_side(tmp_path: Path, drawn: list[Any]) -> None:
    tracking = written("tracking", (True, [1.0, 2.0]), (False, [4.0]))
    venue = written("venue", (True, [1.0, None]), aids="wifi")
    plot_reports([tracking, venue], tmp_path / "x.png")
    found = lines(drawn[0])
    assert set(found) == {
        "ilc20, tracking (all, 2 walks)",
        "ilc20, tracking (covered, 1 walks)",
        "ilc20, venue, wifi (all, 1 walks)",
    }
    np.testing.assert_allclose(found["ilc20, tracking (all, 2 walks)"][1], [100 / 3, 200 / 3, 100])
    assert found["ilc20, venue, wifi (all, 1 walks)"] == ([1.0], [50.0])  # no answer or a wrong level is no small error


def test_published_figures_of_reports(tmp_path: Path, drawn: list[Any]) -> None:
    pose = written("pose", (True, [2.0]), set="uji", published={"mean": 4.05, "dead_reckoning_mean": 4.46})
    pose["unknown_start"] = written("cold", (True, [5.0]), set="uji")
    rows = [{"method": "A", "mean_all": 2.5}, {"method": "B", "mean_all": 1.753}, {"method": "C", "mean_all": None}]
    plot_reports([pose, written("cold", (True, [1.0]), set="kaist", published=rows)], tmp_path / "x.png")
    found = lines(drawn[0])
    upright = {label: x[0] for label, (x, _) in found.items() if label.startswith("published")}
    assert upright == {
        "published: uji, mean error 4.05 m": 4.05,
        "published: uji, mean of dead reckoning 4.46 m": 4.46,
        "published: kaist, B, mean error of a run 1.75 m": 1.753,
    }
    assert "uji, cold (all, 1 walks)" in found
