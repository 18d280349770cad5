"""The reader of the ``kaist`` folder format, on a stand-in."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from app.engine.mapping import FloorPlan
from app.evaluation.datasets.kaist import KaistFloor, open_kaist, track_number
from app.evaluation.errors import DataSetError
from tests.evaluation.halls import TRACK, hall, write_kaist


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("data")
    write_kaist(folder / "kaist" / "H-1F", hall())
    return folder


@pytest.fixture
def floor(data: Path) -> KaistFloor:
    return open_kaist(data).floor("H-1F")


def test_walks_by_kind(floor: KaistFloor) -> None:
    assert len(floor.walks("survey")) == 18
    assert [(w.walk_id, w.device) for w in floor.walks("test")] == [
        ("test-s9-1", "Galaxy S9"),
        ("test-other-1", "Other 2 Pro"),
    ]
    walk = floor.walks("test")[0]
    assert len(walk.waypoints) == len(TRACK)
    assert walk.path_length_m == pytest.approx(16 + 12 + 8 + 8 + 7)
    assert walk.samples.t[0] == pytest.approx(walk.waypoints.t[0], abs=0.01)
    assert not walk.even_pace


def test_the_survey_phone_points_along_x_and_the_test_phone_along_the_walk(floor: KaistFloor) -> None:
    assert {walk.survey_walk().device_heading for walk in floor.walks("survey")} == {0.0}
    assert {walk.device_heading for walk in floor.walks("test")} == {None}


def test_the_plan_is_an_outline_with_a_hole(floor: KaistFloor) -> None:
    plan = FloorPlan.from_geojson(floor.plan)
    assert plan.extent == (-1, -1, 21, 17)
    assert (len(plan.outline), len(plan.units), len(plan.outline[0].rings)) == (1, 0, 2)
    ring = floor.plan["features"][0]["geometry"]["coordinates"][0]
    assert ring[0] == ring[-1]


def test_the_extent_is_that_of_the_picture(floor: KaistFloor) -> None:
    assert floor.extent == (-1.0, -1.0, 21.0, 17.0)


def test_published_runs_by_setting(floor: KaistFloor) -> None:
    found = {(p.method, p.particles, p.map_step_m): (p.track.tolist(), p.error_m.tolist()) for p in floor.published}
    assert found == {("ILoA", 4000, 1.0): ([1, 2, 3], [1.5] * 3), ("MaLoc", 4000, 1.0): ([1, 2, 3], [12.0] * 3)}


def test_without_the_optional_files(tmp_path: Path) -> None:
    write_kaist(tmp_path / "H-1F", hall()[:2])
    for name in ("floor_image.png", "published_runs.parquet"):
        (tmp_path / "H-1F" / name).unlink()
    floor = open_kaist(tmp_path).floor("H-1F")
    assert (floor.plan_png_path, floor.published, floor.extent) == (None, (), (-1, -1, 21, 17))


def test_rows_that_are_no_numbers_are_left_out(tmp_path: Path) -> None:
    line = hall()[0]
    mag = line.samples.mag.copy()
    mag[5] = np.nan
    write_kaist(tmp_path / "H-1F", [replace(line, samples=replace(line.samples, mag=mag))])
    (walk,) = open_kaist(tmp_path).floor("H-1F").walks("survey")
    assert len(walk.samples) == len(line.samples) - 1


def test_what_is_wrong_is_named(tmp_path: Path, data: Path) -> None:
    with pytest.raises(DataSetError, match="kaist/<floor>"):
        open_kaist(tmp_path)
    with pytest.raises(DataSetError, match=r"no floor 'B7'; found: H-1F"):
        open_kaist(data).floor("B7")
    write_kaist(tmp_path / "H-1F", hall()[:1])
    for text in ("[]", json.dumps({"walkable": {"outer": [[1, "a"]], "holes": []}}), json.dumps({"walkable": 3})):
        (tmp_path / "H-1F" / "floor.json").write_text(text)
        with pytest.raises(DataSetError, match=r"floor\.json"):
            _ = open_kaist(tmp_path).floor("H-1F").plan


@pytest.mark.parametrize(("name", "number"), [("test-s9-2", 2), ("test-iphone-13", 13), ("test", None)])
def test_track_number(name: str, number: int | None) -> None:
    assert track_number(name) == number
