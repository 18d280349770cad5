"""Tiles: any map comes back bit by bit, equal content is stored once, every difference changes the hash."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from app.engine.errors import MapError
from app.engine.types import FeatureSet, GridMap
from app.services.records import PackedMap
from app.storage.tiles import TILE, MapHeader, header_of, pack_map, unpack_map
from tests.support.builders import grid_map

SIDES = st.one_of(st.integers(1, 8), st.sampled_from([TILE - 1, TILE, TILE + 1, 2 * TILE, 2 * TILE + 3]))
COORDINATES = st.floats(-1e6, 1e6)


@st.composite
def any_map(draw: st.DrawFn) -> GridMap:
    features = draw(st.sampled_from(FeatureSet))
    k, shape = len(features.channels), (draw(SIDES), draw(SIDES))
    any_float32 = st.floats(width=32, allow_nan=True, allow_infinity=True)

    def layer(*lead: int) -> np.ndarray:
        return draw(hnp.arrays(np.float32, (*lead, *shape), elements=any_float32, fill=any_float32))

    return GridMap(
        level_id=draw(st.text(max_size=12)),
        features=features,
        x0=draw(COORDINATES),
        y0=draw(COORDINATES),
        cell_m=draw(st.floats(0.01, 10)),
        mean=layer(k),
        sd=layer(k),
        support=layer(),
        mapped_m=draw(st.floats(0, 10)),
        noise_sd=tuple(draw(st.lists(st.floats(0, 10), min_size=k, max_size=k))),
        obstacle=layer() if draw(st.booleans()) else None,
    )


def _unpack(given_map: GridMap, packed: PackedMap) -> GridMap:
    header = MapHeader.from_json(header_of(given_map).to_json())
    return unpack_map(header, [(tile.row, tile.column, tile.data) for tile in packed.tiles])


@settings(max_examples=50, deadline=None)
@given(any_map())
def test_any_map_round_trips_to_the_bit(given_map: GridMap) -> None:
    back = _unpack(given_map, pack_map(given_map))
    assert header_of(back) == header_of(given_map)
    assert (back.obstacle is None) == (given_map.obstacle is None)
    for name in ("mean", "sd", "support", "obstacle"):
        before, after = getattr(given_map, name), getattr(back, name)
        if before is None:
            continue
        assert after.dtype == np.float32
        np.testing.assert_array_equal(after.view(np.uint32), before.view(np.uint32), err_msg=name)


def test_equal_maps_have_equal_hashes_also_when_not_contiguous() -> None:
    one = grid_map()
    other = replace(one, mean=np.asfortranarray(one.mean), support=np.asfortranarray(one.support))
    assert pack_map(one) == pack_map(other)


@pytest.mark.parametrize(
    "change",
    [
        {"level_id": "other"},
        {"x0": -3.5000001},
        {"y0": 0.0},
        {"cell_m": 0.25},
        {"mapped_m": 2.0},
        {"noise_sd": (0.75, 0.9)},
    ],
    ids=str,
)
def test_every_part_of_the_header_counts(change: dict[str, object]) -> None:
    one = grid_map()
    assert pack_map(one).hash != pack_map(replace(one, **change)).hash  # type: ignore[arg-type]


@pytest.mark.parametrize("layer", ["mean", "sd", "support", "obstacle"])
def test_one_changed_cell_changes_the_hash_and_one_tile(layer: str) -> None:
    one = grid_map(rows=150, columns=150, plan=True)
    changed = getattr(one, layer).copy()
    changed[..., 70, 140] += 1
    before, after = pack_map(one), pack_map(replace(one, **{layer: changed}))
    assert before.hash != after.hash
    different = [new for old, new in zip(before.tiles, after.tiles, strict=True) if old.hash != new.hash]
    assert [(tile.row, tile.column) for tile in different] == [(1, 2)]


def test_a_plan_without_obstacles_is_not_the_same_as_no_plan() -> None:
    one = grid_map()
    assert pack_map(one).hash != pack_map(replace(one, obstacle=np.zeros_like(one.support))).hash


def test_a_missing_a_doubled_and_a_strange_tile_are_refused() -> None:
    one = grid_map()
    header = header_of(one)
    tiles = [(tile.row, tile.column, tile.data) for tile in pack_map(one).tiles]
    with pytest.raises(MapError, match="1 tiles are missing"):
        unpack_map(header, tiles[1:])
    with pytest.raises(MapError, match="twice"):
        unpack_map(header, [*tiles, tiles[0]])
    with pytest.raises(MapError, match="outside"):
        unpack_map(header, [*tiles, (9, 9, tiles[0][2])])


def test_damaged_tiles_are_refused() -> None:
    one = grid_map()
    header = header_of(one)
    tiles = [(tile.row, tile.column, tile.data) for tile in pack_map(one).tiles]
    row, column, data = tiles[0]
    with pytest.raises(MapError, match="damaged"):
        unpack_map(header, [(row, column, data[:-20]), *tiles[1:]])
    # the last tile is smaller: its data does not fit the first place
    with pytest.raises(MapError, match="shape"):
        unpack_map(header, [(row, column, tiles[-1][2]), *tiles[1:]])
