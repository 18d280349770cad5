"""Preparation of a level: surveyed area, map, cache."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from app.engine.errors import MapError
from app.engine.mapping import FloorPlan
from app.engine.types import Evidence, FeatureSet, MapBuild, MapBuildSettings, RadioMap
from app.evaluation import prepare
from app.evaluation.prepare import PrepareTask, load_map, map_key, prepare_level, save_map
from app.storage.tiles import pack_map
from tests.evaluation.fakes import flat_map, straight_walk
from tests.support.builders import grid_map, radio_map, scans

WALKS = tuple(straight_walk(name, duration_s=8.0).survey_walk() for name in "ab")
SQUARE = [[0.0, 0.0], [9.0, 0.0], [9.0, 9.0], [0.0, 0.0]]
PLAN = {
    "type": "FeatureCollection",
    "features": [{"type": "Feature", "properties": {}, "geometry": {"type": "Polygon", "coordinates": [SQUARE]}}],
}
TASK = PrepareTask("x-F1", WALKS, MapBuildSettings())


@pytest.fixture
def built(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Calls of a stand-in for map building."""
    calls: list[str] = []

    def build(level_id, walks, settings, *, plan):
        calls.append(level_id)
        return MapBuild(flat_map(level_id), (), 1, 3.0, (1.0,), Evidence.empty(FeatureSet.HV), {})

    monkeypatch.setattr(prepare, "build_map", build)
    monkeypatch.setattr(prepare, "engine_hash", lambda: "engine")
    return calls


def test_a_map_survives_the_file(tmp_path: Path) -> None:
    path = tmp_path / "new" / "m.npz"
    before = replace(flat_map("x"), obstacle=np.full((30, 50), 2.5, np.float32))
    save_map(before, path)
    again = load_map(path)
    for name in ("level_id", "features", "x0", "y0", "cell_m", "mapped_m", "noise_sd"):
        assert getattr(again, name) == getattr(before, name)
    for name in ("mean", "sd", "support", "obstacle"):
        np.testing.assert_array_equal(getattr(again, name), getattr(before, name))
        assert getattr(again, name).dtype == np.float32
    assert [p.name for p in path.parent.iterdir()] == ["m.npz"]


def test_the_engine_hash_is_that_of_its_source() -> None:
    assert len(prepare.engine_hash()) == 64


def test_the_key_follows_everything_that_the_map_depends_on(monkeypatch: pytest.MonkeyPatch) -> None:
    moved = replace(WALKS[0], samples=replace(WALKS[0].samples, mag=WALKS[0].samples.mag + 1e-3))
    relabelled = replace(WALKS[0], waypoints=replace(WALKS[0].waypoints, x=WALKS[0].waypoints.x + 1e-3))
    variants = [
        TASK,
        replace(TASK, name="x-F2"),
        replace(TASK, settings=MapBuildSettings(FeatureSet.HV)),
        replace(TASK, settings=MapBuildSettings(cell_m=0.4)),
        replace(TASK, walks=WALKS[:1]),
        replace(TASK, walks=WALKS[::-1]),
        replace(TASK, walks=(moved, WALKS[1])),
        replace(TASK, walks=(relabelled, WALKS[1])),
        replace(TASK, walks=(replace(WALKS[0], device_heading=0.0), WALKS[1])),
        replace(TASK, settings=MapBuildSettings(align=False)),
        replace(TASK, vector_plan=PLAN),
        replace(TASK, walks=(replace(WALKS[0], wifi=scans()), WALKS[1])),
        replace(TASK, walks=(replace(WALKS[0], ble=scans()), WALKS[1])),
        replace(TASK, walks=(replace(WALKS[0], ble=scans(5)), WALKS[1])),
    ]
    monkeypatch.setattr(prepare, "engine_hash", lambda: "this engine")
    keys = [map_key(task) for task in variants]
    assert len(set(keys)) == len(keys)
    assert map_key(replace(TASK, cache=Path("elsewhere"))) == keys[0]
    monkeypatch.setattr(prepare, "engine_hash", lambda: "another engine")
    assert map_key(TASK) not in keys


def test_the_cache_is_used_only_when_given(tmp_path: Path, built: list[str]) -> None:
    for _ in range(2):
        assert prepare_level(TASK).build_s is not None
    assert len(built) == 2
    cached = replace(TASK, cache=tmp_path / "cache")
    first, second = prepare_level(cached), prepare_level(cached)
    assert len(built) == 3
    assert (first.build_s is None, second.build_s is None) == (False, True)
    assert first.grid_map is not None
    assert second.grid_map is not None
    np.testing.assert_array_equal(first.grid_map.mean, second.grid_map.mean)
    prepare_level(replace(cached, settings=MapBuildSettings(cell_m=0.4)))
    assert len(built) == 4


@pytest.mark.parametrize("radio", [None, radio_map()], ids=["bare", "radio"])
@pytest.mark.parametrize("plan", [False, True])
def test_a_cached_map_is_the_same(tmp_path: Path, radio: RadioMap | None, plan: bool) -> None:
    one = grid_map(plan=plan, radio=radio)
    save_map(one, tmp_path / "map.npz")
    assert pack_map(load_map(tmp_path / "map.npz")) == pack_map(one)


def test_a_level_without_a_map_says_why(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(level_id, walks, settings, *, plan):
        raise MapError("no walk could be placed")

    monkeypatch.setattr(prepare, "build_map", refuse)
    level = prepare_level(TASK)
    assert (level.grid_map, level.problem) == (None, "no walk could be placed")
    assert len(level.area.positions) > 100


def test_the_plan_reaches_the_map(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[FloorPlan | None] = []

    def build(level_id, walks, settings, *, plan):
        seen.append(plan)
        return MapBuild(flat_map(level_id), (), 1, 3.0, (1.0,), Evidence.empty(FeatureSet.HV), {})

    monkeypatch.setattr(prepare, "build_map", build)
    prepare_level(TASK)
    prepare_level(replace(TASK, vector_plan=PLAN))
    assert seen[0] is None
    assert seen[1] is not None
    assert seen[1].extent == (0.0, 0.0, 9.0, 9.0)
    assert prepare_level(replace(TASK, vector_plan={"type": "Nothing"})).problem


def test_the_surveyed_area_alone(built: list[str]) -> None:
    level = prepare_level(replace(TASK, with_map=False))
    assert (level.grid_map, level.n_walks, built) == (None, 2, [])
    assert np.ptp(level.area.positions[:, 0]) > 5.0
    np.testing.assert_allclose(level.area.positions[:, 1], 2.0)
