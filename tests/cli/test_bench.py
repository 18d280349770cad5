"""``isodyn bench kernels``: a table to read and rows to keep."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from app.cli.bench import _cells, _duration
from app.evaluation.kernels import Row
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
