"""Whole runs of the papers' protocols over stand-ins of the data, with matchers that are obviously right or wrong."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from app.engine.matching import read_map
from app.engine.types import FeatureSet, Status
from app.evaluation.errors import DataSetError, OptionsError
from app.evaluation.papers import anomalies, matching, s1, s3, s4
from app.evaluation.papers.figures import median, quantile, region_figures
from app.evaluation.papers.matching import Outcome, registered, run_trials, suited
from app.evaluation.papers.plots import plot_papers
from app.evaluation.papers.report import PapersReport
from app.evaluation.papers.run import PapersOptions, run_papers
from tests.evaluation.halls import hall, laboratory, write_kaist, write_uji
from tests.evaluation.matchers import Clueless, Exhaustive, Refusing, Sliding, Staying, entry
from tests.evaluation.surveys import SETTINGS, write_aero

TRACKS = 3
ENTRIES = (
    entry("staying", Staying),
    entry("exhaustive", Exhaustive),
    entry("refusing", Refusing),
    entry("clueless", Clueless),
    entry("indoor_only", Staying, scales=("indoor",)),
    entry("dtw", Sliding, needs_routes=True),
    entry("ddtw", Clueless, needs_routes=True),
    entry("voting_dtw", Sliding, needs_routes=True),
    entry("declination_aided", Staying),
)
AREA = {"staying", "exhaustive", "refusing", "clueless", "declination_aided"}


@pytest.fixture(scope="module", autouse=True)
def registry() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(matching, "MATCHERS", {one.name: one for one in ENTRIES})
        patch.setattr(anomalies, "_FIT_POINTS", 300)
        yield


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("data")
    write_aero(folder / "aero")
    write_uji(folder / "uji", laboratory())
    write_kaist(folder / "kaist" / "KI-1F", hall())
    return folder


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("cache")


@pytest.fixture(scope="module")
def report(data: Path, cache: Path) -> PapersReport:
    said: list[float] = []
    options = PapersOptions(data, tracks=TRACKS, cache=cache, anomalies=SETTINGS)
    found = run_papers(options, lambda fraction, _what: said.append(fraction))
    assert said == sorted(said)
    return found


def test_json_keeps_the_contract(report: PapersReport) -> None:
    result = json.loads(report.to_json(), parse_constant=lambda name: pytest.fail(f"{name} in JSON"))
    assert set(result["s4"]) == {"marine", "land", "marine_lines", "land_lines"}
    for region in result["s4"].values():
        assert set(region) == AREA
        for figures in region.values():
            assert figures.keys() >= {"north", "east", "failure_rate", "ms", "tracks"}
            assert figures["tracks"] == TRACKS
    assert set(result["s1"]) == {"uji", "kaist", "cart"}
    assert all(set(windows) == {"20", "40", "60"} for windows in result["s1"].values())
    assert set(result["s3"]["voting_dtw"]) == {"uji", "lane"}
    assert set(result["s3"]["declination_aided"]) == {"uji", "office"}


def test_the_field_finds_what_staying_misses(report: PapersReport) -> None:
    """On the map itself the exhaustive search ends within a cell of the truth and of the drift."""
    result = report.to_dict()["s4"]["land"]
    assert result["exhaustive"]["p50"] < 600.0
    assert max(result["exhaustive"]["north_held"], result["exhaustive"]["east_held"]) < 600.0
    assert result["exhaustive"]["failure_rate"] < result["staying"]["failure_rate"]
    indicated = report.to_dict()["about"]["s4"]["land"]["indicated"]
    assert result["staying"]["north"] == pytest.approx(indicated["north"], abs=0.01)


def test_refusals_and_answers_without_a_place_are_failures(report: PapersReport) -> None:
    result = report.to_dict()["s4"]["marine"]
    assert result["refusing"]["failure_rate"] == result["clueless"]["failure_rate"] == 1.0
    assert result["refusing"]["refused"] == ["region: is missing"]
    assert result["clueless"]["north"] is None
    assert result["clueless"]["errors_m"] == [None] * TRACKS


def test_sequences_are_found(report: PapersReport) -> None:
    result = report.to_dict()
    assert result["s1"]["kaist"]["60"]["dtw"]["p50"] < 3.0
    assert result["s1"]["cart"]["60"]["dtw"]["p50"] < 1.0
    assert result["s1"]["kaist"]["60"]["dtw"]["fixes"] == TRACKS
    assert result["s3"]["voting_dtw"]["lane"]["accepted"] == 1.0
    assert result["s1"]["cart"]["20"]["ddtw"]["located"] == 0.0
    aided = result["s3"]["declination_aided"]["office"]
    assert aided["heading_before_deg"] == aided["heading_after_deg"] > 10.0
    assert aided["mean_m"] == aided["mean_without_m"]


def test_what_is_not_registered_is_left_out_with_a_note(report: PapersReport) -> None:
    assert {note for note in report.notes if "improved_dtw" in note} == {
        "s1: improved_dtw: not in the registry, left out"
    }
    assert registered(("dtw", "none")) == (("dtw",), ("none: not in the registry, left out",))


def test_the_table_has_the_papers_figures(report: PapersReport) -> None:
    table = report.table()
    for line in ("paper: magcom", "paper: icm", "374", "30900", "4.65", "91 %", "63.70", "94 %", "not comparable"):
        assert line in table
    assert "note: s1: improved_dtw" in table


def test_plots(report: PapersReport, tmp_path: Path) -> None:
    assert report.s4 is not None
    paths = plot_papers(replace(report, s4=report.s4[-1:]), tmp_path)
    names = [path.relative_to(tmp_path).as_posix() for path in paths]
    others = ["s4/errors.png", "s1/windows.png", "s3/voting.png", "s3/declination.png"]
    assert names == ["s4/land_lines.png", *others]
    assert all(path.is_file() for path in paths)
    assert plot_papers(PapersReport(), tmp_path / "none") == []


def test_only_some_papers(data: Path, cache: Path) -> None:
    report = run_papers(PapersOptions(data, only=("s4",), tracks=1, cache=cache, anomalies=SETTINGS))
    values = report.to_dict()
    assert "s4" in values
    assert not {"s1", "s3"} & set(values)


def test_options_and_data_that_cannot_be(data: Path, tmp_path: Path) -> None:
    with pytest.raises(OptionsError, match="tracks"):
        PapersOptions(data, tracks=0)
    with pytest.raises(OptionsError, match="only: knows s1, s3, s4, not s2"):
        PapersOptions(data, only=("s2",))
    with pytest.raises(DataSetError, match="holds no aero"):
        run_papers(PapersOptions(tmp_path, only=("s4",)))


def test_methods_by_what_they_can() -> None:
    assert set(suited("area", FeatureSet.TOTAL)) == AREA
    assert set(suited("area", FeatureSet.TOTAL, routes=True)) == {"dtw", "ddtw", "voting_dtw"}


def test_tracks_are_as_the_paper_has_them(data: Path, cache: Path) -> None:
    ground, _ = s4.choose_grounds(data, SETTINGS, cache)
    for recorded in (False, True):
        rng = np.random.default_rng(1)
        for trial in s4.draw_trials(ground, 10, rng, SETTINGS, recorded=recorded):
            steps = np.hypot(np.diff(trial.x), np.diff(trial.y))
            np.testing.assert_allclose(steps, 200.0, atol=5.0)
            track = trial.problem.track
            away = np.hypot(track.x[0] - trial.x[0], track.y[0] - trial.y[0])
            assert away <= 4000.0
            drift = np.hypot(track.x[-1] - track.x[0] - (trial.x[-1] - trial.x[0]),
                             track.y[-1] - track.y[0] - (trial.y[-1] - trial.y[0]))  # fmt: skip
            assert 100.0 < drift < 700.0
            assert float(np.sqrt(np.trace(track.cov[-1]))) == pytest.approx(drift, rel=0.6)
            reading = read_map(trial.problem.grid_map, FeatureSet.TOTAL, trial.x, trial.y).mean
            residual = 1000.0 * (trial.problem.profile.values - reading)
            assert (float(residual.std()) < 1.5) == (not recorded)


def test_the_same_tracks_each_time(data: Path, cache: Path) -> None:
    ground, _ = s4.choose_grounds(data, SETTINGS, cache)
    a, b = (s4.draw_trials(ground, 2, np.random.default_rng(4), SETTINGS, recorded=True) for _ in range(2))
    np.testing.assert_array_equal(a[1].problem.profile.values, b[1].problem.profile.values)


def test_windows_end_where_the_truth_does() -> None:
    for trial in (*s1.cart_trials(40, 3), *s3.lane_trials(3), *s3.office_trials(2)):
        problem = trial.problem
        reading = read_map(problem.grid_map, problem.profile.features, trial.x, trial.y).mean
        if problem.profile.features is FeatureSet.TOTAL:
            assert float((problem.profile.values - reading).std()) == pytest.approx(s1.CART_NOISE_UT, rel=0.3)
        else:  # the vertical component is the same whatever the headings
            assert float(np.abs(problem.profile.values - reading)[:, 2].mean()) < 1.5


def test_compass_headings_lie_where_steel_bends_the_field() -> None:
    (trial,) = s3.office_trials(1)
    before = s3.heading_errors(trial, trial.problem.track.x, trial.problem.track.y)
    assert np.degrees(before.mean()) > 10.0
    assert s3.heading_errors(trial, trial.x, trial.y).max() < 1e-9
    turned = s3.heading_errors(trial, -trial.y, trial.x)
    np.testing.assert_allclose(turned, np.pi / 2, atol=1e-6)


def test_figures_count_failures_and_those_called_ok() -> None:
    def outcome(dx: float, status: Status) -> Outcome:
        return Outcome("a", status, dx, -10.0, np.array([dx]), 0.002)

    claims = ((100.0, Status.OK), (2000.0, Status.OK), (3000.0, Status.AMBIGUOUS), (np.nan, Status.OFF_MAP))
    one = region_figures([outcome(dx, status) for dx, status in claims])
    assert (one["north"], one["east"], one["east_held"]) == (10.0, 1700.0, 100.0)
    assert (one["failure_rate"], one["ok_failure_rate"], one["not_ok_rate"]) == (0.75, 0.5, 0.5)
    assert one["ms"] == 2.0


def test_quantiles_of_what_may_be_missing() -> None:
    assert median([1.0, 2.0, np.inf]) == 2.0
    assert median([1.0, np.inf, np.inf]) is None
    assert quantile([], 0.9) is None


def test_answers_come_in_the_order_of_the_trials() -> None:
    trials = s3.lane_trials(5)
    answers = run_trials(("staying", "refusing"), trials)
    assert [one.trial for one in answers["staying"]] == [trial.name for trial in trials]
    assert all(one.status is None and not one.located for one in answers["refusing"])
    assert run_trials(("staying",), ()) == {"staying": ()}
