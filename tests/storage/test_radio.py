"""Radio layers: any layer comes back byte by byte, every difference changes its hash and the map's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from app.engine.errors import MapError
from app.engine.types import RadioMap
from app.storage.radio import pack_radio, unpack_radio
from app.storage.tiles import header_of, pack_map, unpack_map
from tests.support.builders import grid_map, radio_map

ARRAYS = ("mean", "sd", "seen")


@st.composite
def any_radio(draw: st.DrawFn) -> RadioMap:
    addresses = tuple(draw(st.lists(st.text(max_size=6), max_size=4, unique=True)))
    shape = (len(addresses), draw(st.integers(0, 4)), draw(st.integers(0, 4)))
    kinds = {"mean": np.int8, "sd": np.uint8, "seen": np.uint8}
    arrays = {name: draw(hnp.arrays(kind, shape)) for name, kind in kinds.items()}
    place = {name: draw(st.floats(-1e6, 1e6)) for name in ("x0", "y0", "cell_m")}
    return RadioMap(addresses=addresses, **place, **arrays)


def assert_same(one: RadioMap | None, other: RadioMap | None) -> None:
    assert one is not None
    assert other is not None
    assert (one.x0, one.y0, one.cell_m, one.addresses) == (other.x0, other.y0, other.cell_m, other.addresses)
    for name in ARRAYS:
        before, after = getattr(one, name), getattr(other, name)
        assert before.dtype == after.dtype
        np.testing.assert_array_equal(after, before, err_msg=name)


@settings(max_examples=50, deadline=None)
@given(any_radio())
def test_any_layer_round_trips(radio: RadioMap) -> None:
    assert_same(unpack_radio(pack_radio(radio).data), radio)


def test_a_map_brings_its_layer_along() -> None:
    given_map = grid_map(radio=radio_map())
    packed = pack_map(given_map)
    assert packed.radio is not None
    tiles = [(tile.row, tile.column, tile.data) for tile in packed.tiles]
    assert_same(unpack_map(header_of(given_map), tiles, packed.radio.data).radio, given_map.radio)
    assert unpack_map(header_of(given_map), tiles).radio is None


def test_a_map_without_radio_keeps_the_hash_it_always_had() -> None:
    # taken on 2026-11-22, before maps had radio layers
    assert pack_map(grid_map()).hash == "131858e2eb2f9d4350c368867f62768cc6ac79725c7054e97ff76d6ad9784030"
    assert pack_map(grid_map(plan=True)).hash == "50b9782818e513aa16af1a470a07c7121316ee9bae1a293dfcf3e9d3aafa3e94"


@pytest.mark.parametrize("change", ["x0", "y0", "cell_m", "addresses", *ARRAYS])
def test_every_part_counts_for_the_hash_of_the_map_but_not_for_its_tiles(change: str) -> None:
    radio = radio_map()
    value = getattr(radio, change)
    if change in ARRAYS:
        value = value.copy()
        value[2, 3, 4] += 1
    else:
        value = (*value[:-1], "ff") if change == "addresses" else value + 0.5
    before, after = pack_map(grid_map(radio=radio)), pack_map(grid_map(radio=replace(radio, **{change: value})))
    assert before.radio is not None
    assert after.radio is not None
    assert before.radio.hash != after.radio.hash
    assert before.hash != after.hash
    assert before.tiles == after.tiles


def test_equal_layers_have_equal_hashes_also_when_not_contiguous() -> None:
    radio = radio_map()
    assert pack_radio(replace(radio, mean=np.asfortranarray(radio.mean))) == pack_radio(radio)


@pytest.mark.parametrize(
    "change",
    [
        {"addresses": ("a", "b")},
        {"sd": np.zeros((5, 12, 19), np.uint8)},
        {"mean": np.zeros((5, 12, 20), np.float32)},
        {"seen": np.zeros((5, 240), np.uint8)},
    ],
    ids=lambda change: next(iter(change)),
)
def test_arrays_that_do_not_fit_are_refused(change: dict[str, object]) -> None:
    with pytest.raises(MapError, match="does not fit"):
        pack_radio(replace(radio_map(), **change))  # type: ignore[arg-type]


def test_damaged_layers_are_refused() -> None:
    data = pack_radio(radio_map()).data
    for broken, message in (
        (data[:3], "shorter"),
        (b"XX" + data[2:], "version"),
        (data[:-20], "damaged"),
        (data[:30] + b"\xff" + data[31:], "damaged"),
        (data.replace(b'"rows": 12', b'"rows": 13'), "shape"),
    ):
        with pytest.raises(MapError, match=message):
            unpack_radio(broken)


def test_a_large_layer_stays_small_enough() -> None:
    """2,000 transmitters over 3,000 nodes, most of them not heard at most nodes, as they are."""
    rng = np.random.default_rng(0)
    shape = (2000, 50, 60)
    seen = np.where(rng.random(shape) < 0.05, rng.integers(1, 256, shape), 0).astype(np.uint8)
    mean = np.where(seen > 0, rng.integers(-95, -40, shape), -100).astype(np.int8)
    sd = np.where(seen > 0, rng.integers(30, 90, shape), 60).astype(np.uint8)
    radio = replace(radio_map(2000, rows=50, columns=60), mean=mean, sd=sd, seen=seen)
    packed = pack_radio(radio)
    assert len(packed.data) < 0.25 * 3 * mean.size
    assert_same(unpack_radio(packed.data), radio)
