"""Whole runs over a stand-in of the hall."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from app.evaluation.errors import DataSetError, OptionsError
from app.evaluation.kaist import KaistOptions, KaistReport, run_kaist
from tests.evaluation.fakes import FAKE_ENGINE
from tests.evaluation.halls import hall, write_kaist
from tests.evaluation.test_run import CONTRACT, S_KEYS

PROTOCOL = {"n_runs", "converged_share", "mean_converged", "mean_all"}


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("data")
    write_kaist(folder / "kaist" / "H-1F", hall())
    return folder


@pytest.fixture(scope="module")
def report(data: Path) -> KaistReport:
    """The real engine, three cold starts a track."""
    return run_kaist(KaistOptions(data, floor="H-1F", runs=3))


def fake(data: Path, **options: object) -> KaistReport:
    return run_kaist(KaistOptions(data, floor="H-1F", method="clueless", **options), engine=FAKE_ENGINE)  # type: ignore[arg-type]


def test_json_keeps_the_contract(report: KaistReport) -> None:
    result = json.loads(report.to_json(), parse_constant=lambda name: pytest.fail(f"{name} in JSON"))
    assert result.keys() >= CONTRACT | {"protocol", "tracks", "devices", "published", "first_fix", "floor", "runs"}
    assert (result["set"], result["scenario"], result["floor"], result["runs"]) == ("kaist", "cold", "H-1F", 3)
    assert result["device"] is None
    assert set(result["levels"]) == {"H-1F"}
    assert set(result["overall"]["all"]) == set(result["overall"]["covered"]) == S_KEYS
    assert set(result["protocol"]) == PROTOCOL | {"tracks"}
    assert set(result["protocol"]["tracks"]) == set(result["tracks"]) == {"test-s9-1", "test-other-1"}
    for block in (*result["tracks"].values(), *result["devices"].values()):
        assert set(block["all"]) == S_KEYS
        assert set(block["protocol"]) == PROTOCOL
    assert [(w["walk_id"], w["run"]) for w in result["walks"]] == [
        (name, run) for name in ("test-s9-1", "test-other-1") for run in range(3)
    ]
    assert len(result["walks"][0]["corner_errors_m"]) == 4


def test_cold_starts_find_the_walker(report: KaistReport) -> None:
    """A field of 8 uT and lines a metre apart: the engine converges, on the other phone too."""
    protocol = report.to_dict()["protocol"]
    assert protocol["converged_share"] == 1.0
    assert protocol["mean_all"] < 2.5
    first = report.to_dict()["first_fix"]
    assert first["found_share"] == 1.0
    assert 0.0 <= first["p50_m"] < 40.0
    assert first["after"]["p50"] < 2.0


def test_runs_differ_and_repeat(report: KaistReport, data: Path) -> None:
    errors = [run.error_m for run in report.tracks["test-s9-1"]]
    assert len(set(errors)) == 3
    again = run_kaist(KaistOptions(data, floor="H-1F", device="s9", runs=2, jobs=2))
    assert [run.error_m for run in again.tracks["test-s9-1"]] == errors[:2]


def test_published_runs_are_those_of_the_same_tracks(report: KaistReport) -> None:
    published = report.to_dict()["published"]
    assert [(p["method"], p["n_runs"], p["converged_share"]) for p in published] == [
        ("ILoA", 1, 1.0),
        ("MaLoc", 1, 0.0),
    ]
    assert published[0]["tracks"]["1"]["mean_all"] == 1.5


def test_one_device(data: Path) -> None:
    for name in ("S9", "galaxy s9", "GALAXY-S9"):
        assert set(fake(data, device=name, runs=1).tracks) == {"test-s9-1"}
    with pytest.raises(OptionsError, match="found: Galaxy S9, Other 2 Pro"):
        fake(data, device="iPhone")


def test_a_method_without_a_clue(data: Path) -> None:
    report = fake(data, runs=2)
    result = report.to_dict()
    assert result["protocol"]["converged_share"] < 1.0
    assert result["first_fix"]["found_share"] == 0.0
    assert result["first_fix"]["p50_m"] is None
    assert result["status"] == "insufficient"
    assert "published: ILoA" in report.table()


def test_the_table_names_tracks_devices_and_published(report: KaistReport) -> None:
    table = report.table()
    lines = table.splitlines()
    assert lines[0] == "kaist H-1F, cold, particle, 3 runs a track"
    assert [line.split()[0] for line in lines[3:5]] == ["test-s9-1", "test-other-1"]
    assert sum(line.startswith("all tracks") for line in lines) == 3
    assert "100 %" in lines[3]


def test_plots(data: Path, tmp_path: Path) -> None:
    fake(data, runs=1, plots=tmp_path)
    names = {path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*.png")}
    assert names == {"errors.png", "protocol.png", "H-1F/test-s9-1.png", "H-1F/test-other-1.png"}


def test_a_tiny_track_is_dropped_once(tmp_path: Path) -> None:
    recordings = hall()
    tiny = replace(recordings[0], name="test-tiny-7", kind="test", t=recordings[0].t * 0.1)
    write_kaist(tmp_path / "kaist" / "H-1F", [*recordings, tiny])
    report = fake(tmp_path, runs=20)
    assert [d.walk_id for d in report.report.dropped] == ["test-tiny-7"]
    assert "dropped: test-tiny-7" in report.table()


def test_options_and_data_that_cannot_be(data: Path, tmp_path: Path) -> None:
    with pytest.raises(OptionsError, match="runs"):
        KaistOptions(data, runs=0)
    with pytest.raises(OptionsError, match="jobs"):
        KaistOptions(data, jobs=0)
    with pytest.raises(OptionsError, match="method"):
        run_kaist(KaistOptions(data, floor="H-1F", method="magic"))
    write_kaist(tmp_path / "kaist" / "H-1F", hall()[-1:])
    with pytest.raises(DataSetError, match="gives no map"):
        run_kaist(KaistOptions(tmp_path, floor="H-1F"))
