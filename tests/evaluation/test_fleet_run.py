"""What it is worth to know a phone, on a made-up floor whose phones have known offsets."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from app.evaluation.datasets.ilc20 import open_ilc20
from app.evaluation.datasets.walks import RecordedWalk, path_length
from app.evaluation.errors import DataSetError, OptionsError
from app.evaluation.fleet import STARTS, FleetOptions, FleetReport, run_fleet
from tests.evaluation.fakes import FAKE_ENGINE, write_level
from tests.support.walks import Field, survey_of, walk_through

IRON = np.array([[7.0, 0.0, 3.0], [-6.0, 4.0, -3.0], [3.0, -8.0, 0.0], [-4.0, 5.0, 1.0]])
"""Of each phone, uT, body frame (right, forward, up)."""
LOOP = np.array([[2.0, 2.0], [14.0, 2.0], [14.0, 9.0], [2.0, 9.0], [2.0, 2.0]])


def phones_walk() -> tuple[list[RecordedWalk], list[int]]:
    """Three walks of each phone around one loop, and whose they are."""
    rng = np.random.default_rng(2)
    field = Field.random(np.random.default_rng(1))
    walks, owners = [], []
    for number in range(12):
        phone = number % len(IRON)
        corners = np.roll(LOOP[:-1], number % 4, axis=0)[:: 1 if number % 3 else -1] + 0.2 * rng.standard_normal(2)
        walk = walk_through(corners, field, rng, hard_iron=IRON[phone], t0=1_700_000_000.0 + 1000 * number)
        survey = survey_of(walk, f"w{number}")
        length = path_length(survey.waypoints)
        walks.append(RecordedWalk(f"w{number}", "train", walk.samples, survey.waypoints, None, "", length))
        owners.append(phone)
    return walks, owners


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("data") / "ilc20"
    walks, owners = phones_walk()
    write_level(folder / "site-F1", walks)
    traces = pq.read_table(folder / "site-F1" / "traces.parquet")
    for k, axis in enumerate("xyz"):
        traces = traces.append_column(f"mag_bias_{axis}", pa.array([20.0 + 10.0 * owner + k for owner in owners]))
    pq.write_table(traces, folder / "site-F1" / "traces.parquet")
    write_level(folder / "site-F2", walks[:2])
    return folder.parent


@pytest.fixture(scope="module")
def report(data: Path) -> FleetReport:
    return run_fleet(FleetOptions(data, levels=("site-F1",), folds=2), engine=FAKE_ENGINE)


def test_the_bias_names_the_epoch(data: Path) -> None:
    walks = open_ilc20(data).level("site-F1").walks()
    assert [walk.calibration_epoch for walk in walks[:2]] == ["20.0 21.0 22.0", "30.0 31.0 32.0"]
    assert {walk.calibration_epoch for walk in open_ilc20(data).level("site-F2").walks()} == {""}


def test_a_known_phone_starts_nearer_to_its_offset(report: FleetReport) -> None:
    figures = report.summary()["site-F1"]
    assert [figures[start]["walks"] for start in STARTS] == [12, 12, 12]
    nothing, known = (float(figures[start]["horizontal_rms_ut"] or 0.0) for start in ("nothing", "device"))
    assert nothing == pytest.approx(np.sqrt((IRON[:, :2] ** 2).sum(axis=1).mean()), rel=0.35)
    assert known < 0.6 * nothing


def test_json_keeps_every_walk(report: FleetReport) -> None:
    result = json.loads(report.to_json(), parse_constant=lambda name: pytest.fail(f"{name} in JSON"))
    assert len(result["walks"]) == 36
    assert {walk["start"] for walk in result["walks"]} == set(STARTS)
    early = np.concatenate([walk["early_errors_m"] for walk in result["walks"]])
    assert len(early) > 36 * 4
    assert set(result["summary"]) == {"all", "site-F1"}
    assert "device" in report.table()


def test_a_set_without_phones_is_refused(data: Path) -> None:
    with pytest.raises(DataSetError, match="mag_bias"):
        run_fleet(FleetOptions(data, levels=("site-F2",), track=False))
    with pytest.raises(OptionsError):
        FleetOptions(data, folds=1)
