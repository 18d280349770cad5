"""The map cache: filled once, memory-mapped, never half written, bounded."""

from __future__ import annotations

import os
import threading
from pathlib import Path

import numpy as np
import pytest

from app.engine.errors import MapError
from app.engine.types import GridMap
from app.services.records import MapInfo
from app.services.tasks import MapRef
from app.storage import FileMapCache
from app.storage.map_cache import open_map
from tests.support.builders import World, grid_map, radio_map


@pytest.fixture
def info(world: World) -> MapInfo:
    return world.services.maps.current(world.mapped_level().id)


class Loader:
    """Counts how often the map is assembled."""

    def __init__(self, loaded: GridMap) -> None:
        self.loaded = loaded
        self.calls = 0

    def __call__(self) -> GridMap:
        self.calls += 1
        return self.loaded


def test_a_map_is_loaded_once_and_mapped_equal(tmp_path: Path, info: MapInfo) -> None:
    cache = FileMapCache(tmp_path / "cache")
    loader = Loader(grid_map(info.level_id, plan=True))
    ref = cache.ref(info, loader)
    again = FileMapCache(tmp_path / "cache").ref(info, loader)
    assert ref == again
    assert loader.calls == 1
    mapped = cache.open(ref)
    for name in ("mean", "sd", "support", "obstacle"):
        array = getattr(mapped, name)
        np.testing.assert_array_equal(array, getattr(loader.loaded, name))
        assert type(array) is np.ndarray
        assert not array.flags.writeable
    assert mapped.noise_sd == loader.loaded.noise_sd
    assert (mapped.x0, mapped.y0, mapped.cell_m, mapped.mapped_m) == (-3.5, 2.25, 0.5, 1.5)


def test_a_radio_layer_is_mapped_too(tmp_path: Path, info: MapInfo) -> None:
    cache = FileMapCache(tmp_path / "cache")
    radio = radio_map()
    mapped = cache.open(cache.ref(info, Loader(grid_map(info.level_id, radio=radio)))).radio
    assert mapped is not None
    assert (mapped.x0, mapped.y0, mapped.cell_m, mapped.addresses) == (-4.0, 2.0, 2.0, radio.addresses)
    for name in ("mean", "sd", "seen"):
        array = getattr(mapped, name)
        np.testing.assert_array_equal(array, getattr(radio, name))
        assert array.dtype == getattr(radio, name).dtype
        assert type(array) is np.ndarray
        assert array.base is not None  # a view of the file, not a copy
        assert not array.flags.writeable


def test_an_entry_that_lost_its_radio_layer_is_none(tmp_path: Path, info: MapInfo) -> None:
    cache = FileMapCache(tmp_path / "cache")
    ref = cache.ref(info, Loader(grid_map(info.level_id, radio=radio_map())))
    ref.path.with_suffix(".radio").unlink()
    with pytest.raises(MapError, match="not in the cache"):
        cache.open(ref)


def test_radio_layers_count_for_the_room_and_leave_with_their_maps(tmp_path: Path, world: World) -> None:
    level = world.mapped_level()
    first = world.services.maps.current(level.id)
    world.build(level.id, seed=1)
    second = world.services.maps.current(level.id)
    bare = FileMapCache(tmp_path / "measure").ref(first, Loader(grid_map())).path.stat().st_size
    cache = FileMapCache(tmp_path / "cache", max_bytes=2 * bare)
    old = cache.ref(first, Loader(grid_map(radio=radio_map()))).path
    os.utime(old, (1, 1))
    cache.ref(second, Loader(grid_map()))
    assert [path.stem for path in sorted((tmp_path / "cache").iterdir())] == [second.hash] * 2


def test_nothing_is_left_of_a_fill_that_failed(tmp_path: Path, info: MapInfo) -> None:
    def broken() -> GridMap:
        raise MapError("tile is missing")

    cache = FileMapCache(tmp_path / "cache")
    with pytest.raises(MapError):
        cache.ref(info, broken)
    assert list((tmp_path / "cache").iterdir()) == []
    assert cache.ref(info, Loader(grid_map(info.level_id))).path.exists()


def test_threads_that_ask_at_once_assemble_once(tmp_path: Path, info: MapInfo) -> None:
    cache = FileMapCache(tmp_path / "cache")
    loader = Loader(grid_map(info.level_id))
    barrier = threading.Barrier(4)

    def ask() -> None:
        barrier.wait(10)
        cache.ref(info, loader)

    threads = [threading.Thread(target=ask) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(10)
    assert loader.calls == 1
    assert sorted(path.suffix for path in (tmp_path / "cache").iterdir()) == [".json", ".npy"]


def test_the_entry_unused_for_longest_makes_room(tmp_path: Path, world: World) -> None:
    level = world.mapped_level()
    infos = [world.services.maps.current(level.id)]
    for seed in (1, 2):
        world.build(level.id, seed=seed)
        infos.append(world.services.maps.current(level.id))
    one_map = grid_map(level.id)
    size = FileMapCache(tmp_path / "measure").ref(infos[0], Loader(one_map)).path.stat().st_size
    cache = FileMapCache(tmp_path / "cache", max_bytes=2 * size)
    first, second = (cache.ref(one, Loader(one_map)).path for one in infos[:2])
    os.utime(first, (1, 1))
    os.utime(second, (2, 2))
    cache.ref(infos[0], Loader(one_map))  # used: now the second is the older one
    third = cache.ref(infos[2], Loader(one_map)).path
    assert first.exists()
    assert not second.exists()
    assert not second.with_suffix(".json").exists()
    assert third.exists()


def test_even_a_tiny_cache_keeps_what_it_just_filled(tmp_path: Path, info: MapInfo) -> None:
    cache = FileMapCache(tmp_path / "cache", max_bytes=1)
    assert cache.open(cache.ref(info, Loader(grid_map(info.level_id)))).shape == (70, 130)


def test_a_map_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(MapError, match="0123 is not in the cache"):
        FileMapCache(tmp_path).open(MapRef("lvl", "0123", tmp_path / "0123.npy"))
    with pytest.raises(MapError):
        open_map(tmp_path / "0123.npy")
