"""``isodyn bench kernels``: a table to read and rows to keep."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from app.cli.bench import _cells, _duration
from app.cli.store import filled_store
from app.evaluation.kernels import Row
from app.services.search import Near, Search
from tests.cli.conftest import run


def test_a_short_run_writes_rows_and_prints_them(tmp_path: Path) -> None:
    out = tmp_path / "new" / "kernels.json"
    result = run("bench", "kernels", "--only", "particle_step, magcom_mad", "--rounds", "1", "--json", str(out))
    assert result.exit_code == 0, result.output
    rows = json.loads(out.read_text())
    assert [row["task"] for row in rows] == ["magcom_mad", "particle_step"]
    for row in rows:
        assert set(row) >= {"task", "peer", "ours_us", "peer_us", "ratio"}
        assert row["ratio"] > 1.0
        assert row["task"] in result.output


def test_an_unknown_task_is_named() -> None:
    result = run("bench", "kernels", "--only", "teleport")
    assert result.exit_code == 1
    assert "no task teleport; there are dtw_f32" in result.output


@pytest.mark.parametrize(
    ("us", "text"), [(None, "-"), (41.23, "41.2 us"), (1720.0, "1.72 ms"), (132e6, "132 s"), (5e9, "5,000 s")]
)
def test_durations_are_short(us: float | None, text: str) -> None:
    assert _duration(us) == text


def test_rows_without_a_peer_say_why() -> None:
    assert _cells(Row("a", None, 5.0, None, None, "step", "not installed")) == (
        "a",
        "5 us",
        "-",
        "-",
        "step",
        "not installed",
    )
    assert _cells(Row("a", "b", 5.0, 6e3, 1200.0, "step", ""))[3] == "1,200"


def test_a_store_is_filled_and_timed(tmp_path: Path) -> None:
    out = tmp_path / "store.json"
    result = run("bench", "store", "--levels", "12", "--beside", "4", "--rounds", "2", "--json", str(out))
    assert result.exit_code == 0, result.output
    content = json.loads(out.read_text())
    assert {row["levels"] for row in content["timings"]} == {4, 12}
    assert set(content["times"]) == {row["task"] for row in content["timings"]}
    assert all(row["p95_ms"] >= row["p50_ms"] > 0 for row in content["timings"])
    for task in content["times"]:
        assert task in result.output


def test_a_filled_store_answers() -> None:
    with filled_store(9, lambda _share, _text: None) as store, store.database() as uow:
        assert uow.stats().maps == 9
        town = store.towns[0]
        near = Search(near=Near(town.latitude_deg, town.longitude_deg, 5_000.0))
        assert len(uow.levels.find(near, venue_id=None, cursor=None, limit=99).items) == 9
        assert uow.maps.load(store.map_ids[3]).shape == (101, 161)
