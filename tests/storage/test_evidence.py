"""Evidence of maps: packed, shared between versions, kept outside the box of an update."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from datetime import timedelta

import numpy as np
import pytest

from app.engine.errors import MapError
from app.engine.mapping.update import SQUARE
from app.engine.types import Evidence, EvidenceSource, FeatureSet, SourceKind
from app.services.ports import UnitOfWork
from app.services.records import MapKind
from app.storage import Database
from app.storage.evidence import TILE_M, pack_evidence, pack_rows, tiles_in, unpack_evidence
from app.storage.tiles import TILE
from tests.storage.test_repositories import add_level, map_info, write
from tests.support.builders import START, grid_map

LATER = START + timedelta(seconds=5)
SOURCES = (
    EvidenceSource("wlk_1", SourceKind.SURVEY, device="dev_1", t=1.7e9),
    EvidenceSource("ctr_1", SourceKind.SESSION, contributor="key_1", t=1.7e9 + 0.123456),
)


def evidence(seed: int = 0, n: int = 300, *, reach_m: float = 90.0) -> Evidence:
    rng = np.random.default_rng(seed)
    return Evidence(
        FeatureSet.HV,
        SOURCES,
        rng.integers(2, size=n).astype(np.int32),
        rng.uniform(-reach_m, reach_m, (n, 2)).astype(np.float32),
        rng.normal(40.0, 8.0, (n, 2)).astype(np.float32),
        rng.uniform(0.0, 2.0, n).astype(np.float32),
        rng.uniform(0.0, 1.0, n).astype(np.float32),
    )


def ordered(rows: Evidence) -> np.ndarray:
    """Everything of each row, in an order that does not depend on the tiles."""
    names = np.array([source.id == "ctr_1" for source in rows.sources])[rows.source]
    table = np.column_stack([rows.xy, rows.values, rows.spread, rows.weight, names])
    return table[np.lexsort(table.T)]


def test_tiles_hold_all_rows_and_their_sources() -> None:
    rows = evidence()
    tiles = pack_evidence(rows)
    back = unpack_evidence(FeatureSet.HV, [tile.data for tile in tiles])
    np.testing.assert_array_equal(ordered(back), ordered(rows))
    assert set(back.sources) == set(SOURCES)
    assert len({(tile.row, tile.column) for tile in tiles}) == len(tiles) == 36


def test_a_row_lies_in_the_tile_of_its_place() -> None:
    rows = evidence().subset(np.array([0]))
    x, y = -0.01, TILE_M
    (tile,) = pack_evidence(replace(rows, xy=np.array([[x, y]], np.float32)))
    assert (tile.row, tile.column) == (1, -1)
    assert tiles_in((x, y, x, y)) == (range(1, 2), range(-1, 0))
    assert tiles_in((-0.1, -40.0, 0.1, 0.0)) == (range(-2, 1), range(-1, 1))


def test_equal_rows_have_equal_hashes_wherever_the_map_ends() -> None:
    rows = evidence()
    inner = rows.subset(np.flatnonzero((np.abs(rows.xy) < TILE_M).all(axis=1)))
    hashes = {(tile.row, tile.column): tile.hash for tile in pack_evidence(rows)}
    for tile in pack_evidence(inner):
        assert hashes[tile.row, tile.column] == tile.hash


def test_maps_grow_by_the_tiles_they_are_stored_in() -> None:
    assert SQUARE == TILE


def test_no_evidence_has_no_tiles() -> None:
    assert pack_evidence(Evidence.empty(FeatureSet.VECTOR)) == ()
    assert len(unpack_evidence(FeatureSet.VECTOR, [])) == 0


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda data: data[:5], "shorter"),
        (lambda data: b"XX" + data[2:], "is not"),
        (lambda data: data[:20] + b"junk", "damaged"),
    ],
)
def test_damaged_tiles_are_told(damage: Callable[[bytes], bytes], message: str) -> None:
    with pytest.raises(MapError, match=message):
        unpack_evidence(FeatureSet.HV, [damage(pack_rows(evidence()))])


def test_a_tile_of_other_features_is_told() -> None:
    with pytest.raises(MapError, match="2 channels"):
        unpack_evidence(FeatureSet.VECTOR, [pack_rows(evidence())])


def add(uow: UnitOfWork, id_: str, rows: Evidence, **changes: object) -> None:
    packed = uow.maps.pack(grid_map("lvl_1"), rows)
    keep = changes.pop("keep", None)
    info = replace(map_info(id_, content_hash=packed.hash), model={"level": 1}, **changes)  # type: ignore[arg-type]
    uow.maps.add(info, packed, keep=keep)  # type: ignore[arg-type]


def test_an_update_replaces_the_evidence_of_its_box_and_keeps_the_rest(database: Database) -> None:
    write(database, add_level)
    before = evidence()
    box = (-10.0, -10.0, 10.0, 10.0)
    write(database, lambda uow: add(uow, "map_1", before, version=1))
    with database() as uow:
        inside = uow.maps.evidence("map_1", box)
        assert inside is not None
        assert (np.abs(inside.xy) <= TILE_M).all()
    after = evidence(seed=7, n=20, reach_m=5.0)
    write(database, lambda uow: add(uow, "map_2", after, version=2, parent_id="map_1", kind=MapKind.UPDATE, keep=box))
    with database() as uow:
        stored = uow.maps.evidence("map_2")
        whole = uow.maps.evidence("map_1")
        assert stored is not None
        assert whole is not None
        outside = before.subset(np.flatnonzero((np.abs(before.xy) > TILE_M).any(axis=1)))
        np.testing.assert_array_equal(ordered(stored), ordered(Evidence.joined([outside, after])))
        np.testing.assert_array_equal(ordered(whole), ordered(before))
    with database.engine.connect() as connection:
        count = connection.exec_driver_sql("SELECT count(*) FROM evidence_tiles").scalar_one()
    assert count == 36 + 4


def test_a_map_of_before_evidence_was_kept_has_none(database: Database) -> None:
    write(database, add_level)
    with database(write=True) as uow:
        packed = uow.maps.pack(grid_map("lvl_1"))
        uow.maps.add(map_info(content_hash=packed.hash), packed)
    with database() as uow:
        assert uow.maps.evidence("map_1") is None


def test_the_sources_of_a_version_are_those_of_its_line_of_updates(database: Database) -> None:
    write(database, add_level)
    rows = Evidence.empty(FeatureSet.HV)

    def versions(uow: UnitOfWork) -> None:
        add(uow, "map_1", rows, version=1, added=("a", "b"))
        add(uow, "map_2", rows, version=2, parent_id="map_1", kind=MapKind.UPDATE, added=("c",), removed=("a",))
        add(uow, "map_3", rows, version=3, parent_id="map_2", kind=MapKind.UPDATE, added=("a",), removed=("b", "c"))
        add(uow, "map_4", rows, version=4, parent_id="map_3", added=("z",))

    write(database, versions)
    with database() as uow:
        known = [uow.maps.sources(f"map_{i}") for i in range(1, 5)]
    assert known == [{"a", "b"}, {"b", "c"}, {"a"}, {"z"}]
