"""Maps scored by the field along walks that they have not seen, on a made-up floor."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from app.engine.mapping import build_map
from app.engine.mapping.samples import place_samples
from app.evaluation.datasets.walks import RecordedWalk, path_length
from app.evaluation.errors import DataSetError
from app.evaluation.field import FieldOptions, FieldReport, run_field, score_walks
from tests.evaluation.fakes import write_level
from tests.support.walks import Field, survey_of, walk_through

LOOP = np.array([[2.0, 2.0], [14.0, 2.0], [14.0, 9.0], [2.0, 9.0], [2.0, 2.0]])


def recorded(number: int, split: str, *, iron: float = 0.8) -> RecordedWalk:
    """A walk around one loop, with a hard iron of its own."""
    rng = np.random.default_rng(100 + number)
    corners = np.roll(LOOP[:-1], number % 4, axis=0)[:: 1 if number % 3 else -1] + 0.3 * rng.standard_normal(2)
    field = Field.random(np.random.default_rng(1))
    offset = iron * rng.standard_normal(3)
    walk = walk_through(corners, field, rng, hard_iron=offset, t0=1_700_000_000.0 + 1000 * number)
    survey = survey_of(walk, f"w{number}")
    length = path_length(survey.waypoints)
    return RecordedWalk(f"w{number}", split, walk.samples, survey.waypoints, None, "", length)


@pytest.fixture(scope="module")
def walks() -> list[RecordedWalk]:
    return [recorded(number, "test" if number > 9 else "train") for number in range(13)]


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory, walks: list[RecordedWalk]) -> FieldReport:
    folder = tmp_path_factory.mktemp("data")
    write_level(folder / "ilc20" / "x-F1", walks)
    return run_field(FieldOptions(folder))


def test_a_map_predicts_better_than_means_of_cells(report: FieldReport) -> None:
    (level,) = report.levels
    values = level.values()
    assert values["n"] > 100
    assert values["rms_vertical"] < values["baseline_vertical"]
    assert values["rms_horizontal"] < 2.0
    assert values["rms_vertical"] < 2.0


def test_the_variance_is_that_of_all_classes_together(report: FieldReport) -> None:
    values = report.overall.values()
    parts = [one for one in values["by_distance"] if one["n"]]
    assert sum(one["n"] for one in parts) == values["normalized_variance"]["n"]
    mean = sum(one["n"] * one["all"] for one in parts) / values["normalized_variance"]["n"]
    assert mean == pytest.approx(values["normalized_variance"]["all"])
    assert 0.3 < values["normalized_variance"]["all"] < 2.0


def test_a_map_that_claims_too_much_is_found_out(walks: list[RecordedWalk]) -> None:
    train = [walk.survey_walk() for walk in walks if walk.split == "train"]
    build = build_map("x-F1", train)
    survey = [place_samples(walk) for walk in train]
    asked = [place_samples(walk.survey_walk()) for walk in walks if walk.split == "test"]
    honest = score_walks("x-F1", build, survey, asked).values()["normalized_variance"]["all"]
    grid = build.grid_map
    bold = replace(grid, sd=grid.sd / 3.0, noise_sd=tuple(sd / 3.0 for sd in grid.noise_sd))
    boasted = score_walks("x-F1", replace(build, grid_map=bold), survey, asked).values()["normalized_variance"]["all"]
    assert boasted > 5.0 * honest


def test_the_report_is_a_table_and_json(report: FieldReport) -> None:
    assert "x-F1" in report.table()
    read = json.loads(report.to_json())
    assert (read["set"], read["task"], list(read["levels"])) == ("ilc20", "field", ["x-F1"])
    assert read["levels"]["x-F1"]["n"] == read["overall"]["n"]


def test_no_data_is_told(tmp_path: Path) -> None:
    with pytest.raises(DataSetError):
        run_field(FieldOptions(tmp_path))
