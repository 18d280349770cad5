"""Whole runs over a made-up data set with a made-up tracker."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from app.engine.types import Prior
from app.evaluation.drivers import smooth_in_engine
from app.evaluation.errors import DataSetError, OptionsError
from app.evaluation.protocol import Aids, EvaluationOptions, Scenario, Through, make_trip
from app.evaluation.report import RunStatus
from app.evaluation.run import run_ilc20
from tests.evaluation.fakes import (
    FAKE_ENGINE,
    START_MS,
    ClueLessTracker,
    DriftingTracker,
    FakeService,
    MapsOf,
    refuse_to_smooth,
    smooth_to_one_place,
    straight_walk,
    write_level,
)

S_KEYS = {
    "n_walks", "mean", "p50", "p75", "p90", "p95", "end_p50", "end_p90", "end_within_5m", "ellipse95", "sure_share",
    "sure_within_5m", "ms_per_segment",
}  # fmt: skip
CONTRACT = {"set", "scenario", "aids", "through", "levels", "overall", "walks"}


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two levels of one building and a third without a survey; ``c`` runs 20 m beside the survey."""
    folder = tmp_path_factory.mktemp("data")
    survey = straight_walk("s", split="train", y=2.0, duration_s=30.0)
    scans = {name: [(1000 * i, "ap", -60, 100) for i in range(1, 9)] for name in ("a", "c")}
    write_level(
        folder / "ilc20" / "x-F1",
        [survey, straight_walk("a"), straight_walk("c", y=22.0), straight_walk("tiny", duration_s=3.0)],
        wifi=scans,
    )
    write_level(folder / "ilc20" / "x-F2", [replace(survey, walk_id="s2"), straight_walk("b", duration_s=17.0)])
    write_level(folder / "ilc20" / "y-F1", [straight_walk("d")])
    return folder


def run(data: Path, **options: Any):
    engine = options.pop("engine", FAKE_ENGINE)
    transport = options.pop("transport", None)
    return run_ilc20(EvaluationOptions(data, **options), engine=engine, transport=transport)


def without_times(report: dict[str, Any]) -> dict[str, Any]:
    text = json.dumps(report)
    cleared = json.loads(text)

    def clear(node: Any) -> None:
        if isinstance(node, dict):
            for key in [k for k in node if k in ("ms_per_segment", "ms_of_segments")]:
                del node[key]
            for child in node.values():
                clear(child)
        elif isinstance(node, list):
            for child in node:
                clear(child)

    clear(cleared)
    return cleared


def test_json_keeps_the_contract(data: Path) -> None:
    report = json.loads(run(data).to_json(), parse_constant=lambda name: pytest.fail(f"{name} in JSON"))
    assert report.keys() >= CONTRACT
    assert (report["set"], report["scenario"], report["aids"], report["through"]) == (
        "ilc20",
        "tracking",
        "none",
        "engine",
    )
    assert set(report["levels"]) == {"x-F1", "x-F2", "y-F1"}
    for block in [*report["levels"].values(), report["overall"], report["baseline"]["overall"]]:
        assert set(block) == {"all", "covered"}
        assert set(block["all"]) == set(block["covered"]) == S_KEYS
    assert (report["status"], report["aids_used"], report["smoothed"]) == ("ok", False, None)
    assert report["maps"]["x-F1"] == {"n_walks": 1, "build_s": 0.5}


def test_walks_are_listed_with_every_error(data: Path) -> None:
    report = run(data).to_dict()
    assert [(w["walk_id"], w["level"], w["covered"]) for w in report["walks"]] == [
        ("a", "x-F1", True), ("c", "x-F1", False), ("b", "x-F2", True),
    ]  # fmt: skip
    walk = report["walks"][0]
    assert len(walk["errors_m"]) == len(walk["t_s"]) == walk["n_scored"] < walk["n_steps"]
    assert min(walk["t_s"]) >= 5.0
    assert walk["n_segments"] == len(walk["ms_of_segments"]) == 6
    assert walk["end"] == pytest.approx(walk["errors_m"][-1], abs=1e-3)
    assert walk["duration_s"] == pytest.approx(29.98, abs=0.01)
    assert walk["statuses"] == {"ok": walk["n_fixes"]}
    assert walk["dead_reckoning"]["p50"] == walk["p50"]  # the stand-in is the same method
    assert walk["smoothed"] is None


def test_overall_pools_the_walks_and_covered_selects_them(data: Path) -> None:
    report = run(data)
    result = report.to_dict()
    overall = result["overall"]
    assert (overall["all"]["n_walks"], overall["covered"]["n_walks"]) == (3, 2)
    errors = [error for walk in result["walks"] for error in walk["errors_m"]]
    assert overall["all"]["mean"] == pytest.approx(sum(errors) / len(errors), abs=1e-3)
    assert result["levels"]["x-F2"]["all"]["n_walks"] == 1
    assert result["levels"]["y-F1"]["all"]["p50"] is None


def test_what_is_not_scored_is_said(data: Path) -> None:
    dropped = run(data).to_dict()["dropped"]
    assert {"level": "y-F1", "walk_id": "", "reason": "no map: no walks"} in dropped
    tiny = next(d for d in dropped if d["walk_id"] == "tiny")
    assert "fewer than 8" in tiny["reason"]


def test_runs_repeat_and_the_number_of_processes_does_not_matter(data: Path) -> None:
    first, second, parallel = (run(data, jobs=jobs).to_dict() for jobs in (1, 1, 2))
    assert without_times(first) == without_times(second) == without_times(parallel)
    other = run(data, repeat=1).to_dict()
    assert other["walks"][0]["errors_m"] != first["walks"][0]["errors_m"]


def test_the_map_comes_from_train_walks_only(data: Path) -> None:
    seen: list[str] = []

    def prepare(task):
        seen.extend(walk.walk_id for walk in task.walks)
        return FAKE_ENGINE.prepare(task)

    run(data, engine=replace(FAKE_ENGINE, prepare=prepare))
    assert seen == ["s", "s2"]


def test_levels_and_limit_choose(data: Path) -> None:
    report = run(data, levels=("x-F1",), limit=1)
    assert [w.walk_id for w in report.walks] == ["a"]
    assert "overall" in report.table()
    assert "x-F1" not in report.table().splitlines()[3]  # one level needs no row of its own


@pytest.mark.parametrize("scenario", [Scenario.COLD, Scenario.VENUE])
def test_a_method_that_needs_a_position_is_insufficient_without_one(data: Path, scenario: Scenario) -> None:
    report = run(data, scenario=scenario)
    result = report.to_dict()
    assert result["status"] == "insufficient"
    assert "insufficient" in report.table()
    assert result["overall"]["all"]["n_walks"] == 3
    assert result["overall"]["all"]["p50"] is None
    assert result["confidence"]["all"]["answered_share"] == 0.0
    assert result["walks"][0]["failures"] == ["start: prior: needs a position"]
    assert result["walks"][0]["dead_reckoning"] is None


def test_a_method_that_says_insufficient_is_taken_at_its_word(data: Path) -> None:
    report = run(data, scenario=Scenario.VENUE, method="clueless")
    assert report.status is RunStatus.INSUFFICIENT
    confidence = report.to_dict()["confidence"]["all"]
    assert confidence["answered_share"] > 0.5
    assert (confidence["located_share"], confidence["first_sure_s"]) == (0.0, None)
    hits = {w.level: w.as_dict()["level_hit_rate"] for w in report.walks}
    assert hits == {"x-F1": 1.0, "x-F2": 0.0}  # it names the first of the building's levels


def test_failed_segments_are_counted(data: Path) -> None:
    report = run(data, method="failing")
    assert report.walks[0].failures
    assert report.to_dict()["walks"][0]["failures"][0].startswith("segment")
    assert "failures; the first: segment" in report.table()


def test_wifi_that_changes_nothing_is_not_called_used(data: Path) -> None:
    assert run(data, aids=Aids(wifi=True)).to_dict()["aids_used"] is False
    used = run(data, aids=Aids(wifi=True), parameters={"hears": True}).to_dict()
    assert (used["aids"], used["aids_used"]) == ("wifi", True)
    assert run(data, aids=Aids(ble=True), parameters={"hears": True}).to_dict()["aids_used"] is False  # none recorded


@pytest.mark.parametrize("aids", [Aids(), Aids(wifi=True), Aids(ble=True)], ids=str)
def test_survey_walks_carry_the_readings_that_are_aids(tmp_path: Path, aids: Aids) -> None:
    survey = straight_walk("s", split="train")
    heard = {"s": [(1000, "beacon", -80)]}
    write_level(tmp_path / "x-F1", [survey, straight_walk("a")], wifi={"s": [(1000, "ap", -60, 0)]}, ble=heard)
    seen: list[tuple[bool, bool]] = []

    def prepare(task):
        seen.extend((walk.wifi is not None, walk.ble is not None) for walk in task.walks)
        return FAKE_ENGINE.prepare(task)

    run(tmp_path, aids=aids, engine=replace(FAKE_ENGINE, prepare=prepare))
    assert seen == [(aids.wifi, aids.ble)]


def test_smoothed_tracks_stand_beside_the_causal_ones(data: Path) -> None:
    report = run(data, engine=replace(FAKE_ENGINE, smoother=smooth_to_one_place)).to_dict()
    walk = report["walks"][0]
    end_x = 0.7 * 30 / 0.55
    assert walk["smoothed"]["end"] == pytest.approx(end_x - 10.0, abs=1.5)
    assert report["smoothed"]["overall"]["all"]["n_walks"] == 3


def test_a_trip_that_cannot_be_smoothed_is_noted(data: Path) -> None:
    report = run(data, engine=replace(FAKE_ENGINE, smoother=refuse_to_smooth))
    assert report.walks[0].smoothed is None
    assert report.walks[0].failures == ("smoothing: too short",)
    assert report.to_dict()["overall"]["all"]["p50"] is not None


def test_the_engine_smooths_its_own_tracker_only() -> None:
    trip = make_trip(straight_walk(), "x", Scenario.TRACKING)
    assert smooth_in_engine(DriftingTracker(), trip, MapsOf(("x",))) is None


def test_unknown_names_are_refused(data: Path, tmp_path: Path) -> None:
    with pytest.raises(OptionsError, match="method"):
        run(data, method="telepathy")
    with pytest.raises(OptionsError, match="parameters"):
        run(data, parameters={"nonsense": 1})
    with pytest.raises(DataSetError, match="nowhere"):
        run(data, levels=("nowhere",))
    with pytest.raises(DataSetError, match="holds no ilc20"):
        run(tmp_path)
    with pytest.raises(OptionsError, match="transport"):
        run(data, through=Through.HTTP)


def test_progress_rises_to_one(data: Path) -> None:
    seen: list[tuple[float, str]] = []
    run_ilc20(EvaluationOptions(data), lambda f, what: seen.append((f, what)), engine=FAKE_ENGINE)
    fractions = [f for f, _ in seen]
    assert fractions == sorted(fractions)
    assert fractions[-1] == 1.0
    assert any("map 2 of 3" in what for _, what in seen)
    assert any(what.startswith("walk") for _, what in seen)


def test_through_a_service(data: Path, tmp_path: Path) -> None:
    service = FakeService()
    report = run(
        data, levels=("x-F1", "x-F2"), through=Through.HTTP, transport=service, jobs=2, plots=tmp_path,
        parameters={"pace": 1.0, "hears": True}, aids=Aids(wifi=True),
    )  # fmt: skip
    result = report.to_dict()
    assert (result["through"], result["status"], result["aids_used"]) == ("http", "ok", True)
    assert [segment.wifi is not None for segment in service.located] == [False, True]  # one walk told it
    assert service.located[0].samples.t[-1] - service.located[0].samples.t[0] > 20.0
    assert [(lvl.site, lvl.name, lvl.ordinal) for lvl in service.levels] == [("x", "F1", 0), ("x", "F2", 1)]
    assert service.walks == {"lvl_1": 1, "lvl_2": 1}
    assert service.closed == len(service.sessions) == 6  # each walk also by dead reckoning
    assert [w["walk_id"] for w in result["walks"]] == ["a", "c", "b"]
    assert result["walks"][0]["dead_reckoning"] is not None
    assert (tmp_path / "x-F1" / "a.png").stat().st_size > 5000


def test_a_building_through_a_service_is_one_venue_of_all_its_levels(data: Path) -> None:
    service = FakeService()
    report = run(data, levels=("x-F2",), scenario=Scenario.VENUE, through=Through.HTTP, transport=service)
    result = report.to_dict()
    assert [(one.site, one.name) for one in service.levels] == [("x", "F1"), ("x", "F2")]
    assert service.built == {"lvl_1", "lvl_2"}
    assert service.venues == ["ven_x"]
    assert [walk["walk_id"] for walk in result["walks"]] == ["b"]
    assert result["confidence"]["all"]["level_hit_rate"] == 1.0  # the stand-in says the highest level
    assert set(result["maps"]) == {"x-F1", "x-F2"}
    other = run(data, levels=("x-F1",), scenario=Scenario.VENUE, through=Through.HTTP, transport=FakeService())
    assert other.to_dict()["confidence"]["all"]["level_hit_rate"] == 0.0


def test_tables_are_aligned(data: Path) -> None:
    report = run(data)
    lines = report.table().splitlines()
    header = lines[1]
    rows = [line for line in lines[3:] if line.startswith(("x-", "y-", "overall"))]
    assert len(rows) == 8
    assert all(len(row) == len(header) for row in rows)
    assert sum(line.startswith("dropped") for line in lines) == 2
    walks = report.walk_table().splitlines()
    assert len(walks) == 5
    assert walks[2].startswith("x-F1 a")


def test_times_are_relative_to_the_walk_however_late_it_was_recorded(tmp_path: Path) -> None:
    """The clock of the recording must not leak into the errors."""
    errors = []
    for number, start in enumerate((START_MS / 1000, START_MS / 1000 + 1e8)):
        walks = [straight_walk("s", split="train", start=start), straight_walk("a", start=start)]
        write_level(tmp_path / str(number) / "x-F1", walks)
        errors.append(run(tmp_path / str(number)).to_dict()["walks"][0]["errors_m"])
    assert len(errors[0]) == len(errors[1])
    assert all(math.isclose(a, b, abs_tol=0.1) for a, b in zip(*errors, strict=True))


@pytest.mark.parametrize(
    ("scenario", "offered"),
    [
        (Scenario.TRACKING, {("x-F1",), ("x-F2",)}),
        (Scenario.COLD, {("x-F1",), ("x-F2",)}),
        (Scenario.VENUE, {("x-F1", "x-F2")}),
    ],
)
@pytest.mark.parametrize("levels", [(), ("x-F1", "x-F2")])
def test_only_the_venue_scenario_offers_the_other_levels(
    data: Path, scenario: Scenario, offered: set[tuple[str, ...]], levels: tuple[str, ...]
) -> None:
    seen: set[tuple[str, ...]] = set()

    class Curious(ClueLessTracker):
        def step(self, state, segment, map_source):
            seen.add(map_source.level_ids())
            return super().step(state, segment, map_source)

    engine = replace(FAKE_ENGINE, create_tracker=lambda name, parameters: Curious())
    run(data, levels=levels, scenario=scenario, engine=engine)
    assert seen == offered


def test_levels_of_a_building_that_are_not_evaluated_are_offered_all_the_same(data: Path) -> None:
    seen: set[tuple[str, ...]] = set()

    class Curious(ClueLessTracker):
        def step(self, state, segment, map_source):
            seen.add(map_source.level_ids())
            return super().step(state, segment, map_source)

    engine = replace(FAKE_ENGINE, create_tracker=lambda name, parameters: Curious())
    report = run(data, levels=("x-F2",), scenario=Scenario.VENUE, engine=engine)
    assert seen == {("x-F1", "x-F2")}
    assert (report.levels, [walk.walk_id for walk in report.walks]) == (("x-F2",), ["b"])


def test_a_fix_on_a_wrong_level_is_wrong_wherever_it_lies(data: Path) -> None:
    class Stubborn(DriftingTracker):
        """Knows the way, and says the building's lowest level."""

        def start(self, prior, *, seed):
            assert prior.level_id is None
            return super().start(Prior("x-F1", 0.0, 2.0), seed=seed)

    engine = replace(FAKE_ENGINE, create_tracker=lambda name, parameters: Stubborn())
    report = run(data, scenario=Scenario.VENUE, engine=engine)
    right, wrong = (next(w for w in report.walks if w.walk_id == name).as_dict() for name in ("a", "b"))
    assert right["p90"] < 5.0
    assert (right["level_hit_rate"], right["end_level_right"]) == (1.0, True)
    assert (wrong["level_hit_rate"], wrong["end_level_right"]) == (0.0, False)
    assert (wrong["p50"], wrong["end"], wrong["mean"], wrong["sure_within_5m"]) == (None, None, None, 0.0)
    assert set(wrong["errors_m"]) == {None}
    result = report.to_dict()
    assert result["overall"]["covered"]["end_within_5m"] == 0.5
    found = result["confidence"]["covered"]
    assert found["end_level_hit_rate"] == 0.5
    assert 0.5 < found["level_hit_rate"] < 0.8
    assert found["sure_level_hit_rate"] == found["level_hit_rate"]
    assert "covered walks on the right level: " in report.table()


def test_the_ends_of_long_walks_are_reported_by_themselves(tmp_path: Path) -> None:
    survey = straight_walk("s", split="train", duration_s=45.0)
    off = straight_walk("off", y=30.0, duration_s=45.0)
    write_level(tmp_path / "x-F1", [survey, straight_walk("short"), straight_walk("long", duration_s=45.0), off])
    report = run(tmp_path)
    ends = report.to_dict()["long_walks"]
    assert ends["min_duration_s"] == 40.0
    assert (ends["overall"]["all"]["n_walks"], ends["overall"]["covered"]["n_walks"]) == (2, 1)
    assert ends["levels"]["x-F1"]["covered"] == ends["overall"]["covered"]
    (long,) = (walk for walk in report.walks if walk.walk_id == "long")
    assert ends["overall"]["covered"]["end_p50"] == pytest.approx(long.as_dict()["end"], abs=1e-3)
    assert "covered walks of 40 s and more: 1, end<5m" in report.table()
