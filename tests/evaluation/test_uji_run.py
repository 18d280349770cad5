"""Whole runs over a stand-in of the laboratory."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from app.engine.calibration import unknown_device
from app.evaluation.datasets.uji import TRAIN, open_uji
from app.evaluation.errors import DataSetError, OptionsError
from app.evaluation.uji import UjiOptions, UjiReport, known_device, run_uji
from tests.evaluation.fakes import FAKE_ENGINE
from tests.evaluation.halls import laboratory, write_uji
from tests.evaluation.test_run import CONTRACT, S_KEYS


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("data")
    write_uji(folder / "uji", laboratory())
    return folder


@pytest.fixture(scope="module")
def report(data: Path) -> UjiReport:
    """The real engine on 10 Hz samples."""
    return run_uji(UjiOptions(data, runs=2))


def test_json_keeps_the_contract(report: UjiReport) -> None:
    result = json.loads(report.to_json(), parse_constant=lambda name: pytest.fail(f"{name} in JSON"))
    assert result.keys() >= CONTRACT | {"unknown_start", "published", "whole", "whole_dead_reckoning", "runs"}
    assert (result["set"], result["scenario"], result["unknown_start"]["scenario"]) == ("uji", "pose", "cold")
    assert result["published"] == {"mean": 4.05, "dead_reckoning_mean": 4.46}
    for form in (result, result["unknown_start"]):
        assert set(form["overall"]["all"]) == set(form["levels"]["laboratory"]["all"]) == set(form["whole"]) == S_KEYS
        assert [(w["walk_id"], w["run"]) for w in form["walks"]] == [("tt01", 0), ("tt01", 1)]
    assert result["walks"][0]["dead_reckoning"]["p50"] is not None
    assert result["unknown_start"]["walks"][0]["dead_reckoning"] is None


def test_ten_hertz_are_enough_on_a_strong_field(report: UjiReport) -> None:
    assert (report.pose.whole().mean or 99.0) < 2.0
    assert (report.cold.whole().end_p50 or 99.0) < 3.0


def test_whole_walks_count_the_first_seconds_too(report: UjiReport) -> None:
    run = report.pose.runs[0]
    assert len(run.whole) == len(run.result.truth) > len(run.result.causal.scores)
    assert run.whole_baseline is not None
    assert len(run.whole_baseline) == len(run.whole)


def test_the_pose_is_the_first_leg(report: UjiReport) -> None:
    prior = report.pose.runs[0].result.prior
    assert (prior.x, prior.y) == pytest.approx((2.0, 2.0), abs=0.1)
    assert prior.heading == pytest.approx(0.0, abs=0.05)
    assert report.cold.runs[0].result.prior.x is None


def test_sessions_start_with_the_stride_of_the_survey(data: Path, report: UjiReport) -> None:
    survey = [walk.survey_walk() for walk in open_uji(data).walks(*TRAIN)]
    known = known_device(survey)
    assert {run.result.prior.calibration for one in (report.pose, report.cold) for run in one.runs} == {known}
    assert known.offset_sd == unknown_device().offset_sd
    assert known.stride_scale_sd < 0.5 * unknown_device().stride_scale_sd
    longer = [replace(walk, waypoints=replace(walk.waypoints, x=1.2 * walk.waypoints.x)) for walk in survey]
    assert known_device(longer).stride_scale == pytest.approx(1.2 * known.stride_scale, rel=0.05)
    assert known_device(survey[:0]) == unknown_device()


def test_the_table(report: UjiReport) -> None:
    lines = report.table().splitlines()
    assert lines[0] == "uji, particle, 2 runs a walk"
    assert [line.split()[0] for line in lines[3:6]] == ["tt01", "all", "published"]
    assert lines[5].split() == ["published", "4.05", "4.46"]


def test_failures_are_noted(data: Path) -> None:
    report = run_uji(UjiOptions(data, runs=1, method="failing"), engine=FAKE_ENGINE)
    assert "failures; the first: segment" in report.table()


def test_plots(data: Path, tmp_path: Path) -> None:
    run_uji(UjiOptions(data, runs=2, method="clueless", plots=tmp_path), engine=FAKE_ENGINE)
    names = {path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*.png")}
    assert names == {f"{s}/{name}.png" for s in ("pose", "cold") for name in ("errors", "laboratory/tt01")}


def test_options_and_data_that_cannot_be(data: Path, tmp_path: Path) -> None:
    with pytest.raises(OptionsError, match="runs"):
        UjiOptions(data, runs=0)
    with pytest.raises(OptionsError, match="method"):
        run_uji(UjiOptions(data, method="magic"))
    write_uji(tmp_path / "uji", laboratory()[-1:])
    with pytest.raises(DataSetError, match="gives no map"):
        run_uji(UjiOptions(tmp_path))
