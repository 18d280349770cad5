"""The survey's lines travel with the map: blob, database, cache."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from app.engine.errors import MapError
from app.engine.types import RouteLines
from app.services.ports import UnitOfWork
from app.storage import Database
from app.storage.map_cache import FileMapCache
from app.storage.routes import pack_routes, unpack_routes
from app.storage.tiles import header_of, pack_map, unpack_map
from tests.storage.test_repositories import add_level, map_info, write
from tests.support.builders import grid_map


def lines_of(*lengths: int, seed: int = 0) -> RouteLines:
    xy = np.random.default_rng(seed).normal(0.0, 50.0, (sum(lengths), 2)).astype(np.float32)
    return RouteLines(xy, np.cumsum([0, *lengths[:-1]]).astype(np.int32))


@settings(max_examples=30, deadline=None)
@given(st.lists(st.integers(1, 9), min_size=1, max_size=5))
def test_any_lines_round_trip(lengths: list[int]) -> None:
    routes = lines_of(*lengths)
    back = unpack_routes(pack_routes(routes).data)
    assert [len(line) for line in back.lines()] == lengths
    np.testing.assert_array_equal(back.xy, routes.xy)


def test_a_map_brings_its_lines_along() -> None:
    one = grid_map(routes=lines_of(4, 7))
    packed = pack_map(one)
    assert packed.routes is not None
    tiles = [(tile.row, tile.column, tile.data) for tile in packed.tiles]
    back = unpack_map(header_of(one), tiles, routes=packed.routes.data)
    assert back.routes is not None
    np.testing.assert_array_equal(back.routes.first, [0, 4])
    assert unpack_map(header_of(one), tiles).routes is None


def test_lines_count_for_the_hash_of_the_map_but_not_for_its_tiles() -> None:
    before, after = pack_map(grid_map(routes=lines_of(4, 7))), pack_map(grid_map(routes=lines_of(5, 6)))
    assert before.tiles == after.tiles
    assert len({before.hash, after.hash, pack_map(grid_map()).hash}) == 3


@pytest.mark.parametrize("first", [[], [1], [0, 0], [0, 5, 3], [0, 11]])
def test_indices_that_do_not_fit_are_refused(first: list[int]) -> None:
    with pytest.raises(MapError, match="do not fit"):
        pack_routes(replace(lines_of(11), first=np.array(first, dtype=np.int32)))


def test_damage_is_found() -> None:
    data = pack_routes(lines_of(4, 7)).data
    for broken in (b"", data[:5], data[:-9], b"XX" + data[2:], data[:12] + b"\xff" + data[13:]):
        with pytest.raises(MapError):
            unpack_routes(broken)


def test_versions_share_their_lines(database: Database) -> None:
    given_lines = (lines_of(4, 7), lines_of(4, 7), lines_of(3), None)
    write(database, add_level)
    for number, routes in enumerate(given_lines, start=1):

        def add(uow: UnitOfWork, number: int = number, routes: RouteLines | None = routes) -> None:
            packed = uow.maps.pack(grid_map("lvl_1", seed=number, plan=True, routes=routes))
            info = map_info(f"map_{number}", version=number, content_hash=packed.hash)
            uow.maps.add(replace(info, n_routes=None if routes is None else len(routes.first)), packed)

        write(database, add)
    with database() as uow:
        for number, routes in enumerate(given_lines, start=1):
            loaded = uow.maps.load(f"map_{number}").routes
            assert uow.maps.get(f"map_{number}").n_routes == (None if routes is None else len(routes.first))
            assert (loaded is None) == (routes is None)
            if loaded is not None and routes is not None:
                np.testing.assert_array_equal(loaded.xy, routes.xy)
    with database.engine.connect() as connection:
        assert connection.exec_driver_sql("SELECT count(*) FROM route_layers").scalar_one() == 2


@pytest.mark.parametrize("routes", [None, lines_of(4, 7)])
def test_the_cache_keeps_lines(tmp_path: Path, routes: RouteLines | None) -> None:
    one = grid_map(routes=routes)
    cache = FileMapCache(tmp_path)
    back = cache.open(cache.ref(map_info("map_1", content_hash=pack_map(one).hash), lambda: one)).routes
    assert (back is None) == (routes is None)
    if back is not None and routes is not None:
        np.testing.assert_array_equal(back.xy, routes.xy)
