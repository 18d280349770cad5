"""Forecasts against what walks left out achieve, over a made-up data set with a made-up tracker."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from app.engine.mapping.forecast import WalkerErrors, forecast_route
from app.evaluation.forecast import Agreement, ForecastReport, Pair, run_forecast
from app.evaluation.prepare import PreparedLevel, PrepareTask
from app.evaluation.protocol import EvaluationOptions
from tests.evaluation.fakes import FAKE_ENGINE, flat_map, prepare_flat, straight_walk, write_level


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> ForecastReport:
    """Nine survey walks, of which three are left out, and one test walk, which is none of ours."""
    folder = tmp_path_factory.mktemp("data")
    walks = [straight_walk(f"w{k}", split="train", y=2.0 + k, duration_s=20.0 + k) for k in range(9)]
    write_level(folder / "ilc20" / "x-F1", [*walks, straight_walk("test")])
    return run_forecast(EvaluationOptions(folder), engine=FAKE_ENGINE)


def test_only_walks_left_out_are_scored(report: ForecastReport) -> None:
    (level,) = report.levels
    assert (level.level, level.walks.n, report.walks.n) == ("x-F1", 3, 3)
    assert level.stretches.n > 3


def test_the_map_does_not_hold_the_walks_left_out(tmp_path: Path) -> None:
    write_level(tmp_path / "ilc20" / "x-F1", [straight_walk(f"w{k}", split="train") for k in range(5)])
    built: list[set[str]] = []

    def prepare(task: PrepareTask) -> PreparedLevel:
        built.append({walk.walk_id for walk in task.walks})
        return prepare_flat(task)

    run_forecast(EvaluationOptions(tmp_path), engine=replace(FAKE_ENGINE, prepare=prepare))
    assert built == [{"w1", "w2", "w3"}]


def test_expected_is_the_forecast_of_the_true_route(report: ForecastReport) -> None:
    assert report.walks.expected_m is not None
    # a flat field: the start's uncertainty and dead reckoning's growth, whichever way
    grid = flat_map("x-F1")
    ends = [straight_walk(duration_s=20.0 + k, y=2.0 + k).waypoints for k in (0, 4, 8)]
    means = []
    for end in ends:
        forecast = forecast_route(grid, np.stack([end.x, end.y], axis=1), WalkerErrors(position_m=1.5))
        means.append((forecast.error[forecast.way > 5.0] ** 2).mean())
    assert report.walks.expected_m == pytest.approx(np.sqrt(np.mean(means)), rel=0.1)


def test_report_as_table_and_json(report: ForecastReport) -> None:
    lines = report.table().splitlines()
    assert [line.split()[0] for line in lines[2:]] == ["x-F1", "all"]
    assert json.loads(report.to_json())["walks"]["n"] == 3


def test_a_level_without_a_map_has_no_figures(tmp_path: Path) -> None:
    write_level(tmp_path / "ilc20" / "x-F1", [straight_walk("test")])
    found = run_forecast(EvaluationOptions(tmp_path), engine=FAKE_ENGINE)
    assert found.walks == Agreement(0, None, None, None, None)
    assert "-" in found.table()


def test_agreement_of_pairs() -> None:
    pairs = [Pair(1.0, 2.0), Pair(2.0, 3.0), Pair(4.0, 10.0)]
    found = Agreement.of(pairs)
    assert found.rank_correlation == pytest.approx(1.0)
    assert found.ratio_p50 == pytest.approx(2.0)
    assert found.expected_m == pytest.approx(np.sqrt(7.0))
    turned = Agreement.of([Pair(1.0, 3.0), Pair(2.0, 2.0), Pair(4.0, 1.0)])
    assert turned.rank_correlation == pytest.approx(-1.0)
