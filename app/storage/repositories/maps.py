"""Map versions, their tiles, and the requests to build them."""

from __future__ import annotations

from collections.abc import Set as AbstractSet
from dataclasses import asdict
from typing import Any

from sqlalchemy import Row, Table, func, insert, null, select

from app.engine.types import FeatureSet, GridMap, MapBuildSettings, WalkReport
from app.services.records import MapInfo, MapOrigin, NewBuild, PackedLayer, PackedMap, PackedTile, Page
from app.storage.models import map_builds, map_tiles, maps, radio_layers, route_layers, tiles
from app.storage.repositories.base import Repository
from app.storage.tiles import header_from, pack_map, unpack_map

_PLAIN = (  # stored as they are
    *("id", "level_id", "version", "parent_id", "hash", "x0", "y0", "cell_m", "rows", "columns", "mapped_m"),
    *(
        "mapped_share",
        "mapped_area_m2",
        "n_walks",
        "n_samples",
        "length_scale_m",
        "build_s",
        "created_at",
        "has_obstacle",
        "n_transmitters",
        "radio_cell_m",
        "n_routes",
    ),
)
_KNOWN_CHUNK = 500  # parameters of one IN list; SQLite takes at least 999


class SqlMapRepository(Repository):
    """Port ``MapRepository``."""

    def add_build(self, job_id: str, build: NewBuild) -> None:
        """Note what a build job is to build."""
        settings = asdict(build.settings)
        self._write(
            insert(map_builds).values(
                job_id=job_id, level_id=build.level_id, settings=settings, survey_ids=list(build.survey_ids)
            )
        )

    def get_build(self, job_id: str) -> NewBuild:
        """What a build job is to build."""
        row = self._one("map build", job_id, select(map_builds).where(map_builds.c.job_id == job_id))
        return NewBuild(row.level_id, _settings(row.settings), tuple(row.survey_ids))

    def pack(self, grid_map: GridMap) -> PackedMap:
        """Cut into tiles, compress and hash; touches no table."""
        return pack_map(grid_map)

    def add(self, info: MapInfo, packed: PackedMap) -> None:
        """Store a map version; tiles and layers that an earlier version has are shared."""
        known = self._known({tile.hash for tile in packed.tiles})
        fresh = {tile.hash: tile for tile in packed.tiles if tile.hash not in known}
        if fresh:
            self._write(insert(tiles), [{"hash": tile.hash, "data": tile.data} for tile in fresh.values()])
        radio_hash = self._add_layer(radio_layers, packed.radio)
        routes_hash = self._add_layer(route_layers, packed.routes)
        self._write(insert(maps).values(**_columns(info), radio_hash=radio_hash, routes_hash=routes_hash))
        self._write(insert(map_tiles), [_place(info.id, tile) for tile in packed.tiles])

    def get(self, map_id: str) -> MapInfo:
        """One map version, without its tiles."""
        return _info(self._one("map", map_id, select(maps).where(maps.c.id == map_id)))

    def list(self, *, level_id: str | None, cursor: str | None, limit: int) -> Page[MapInfo]:
        """Map versions, newest first."""
        statement = select(maps) if level_id is None else select(maps).where(maps.c.level_id == level_id)
        return self._newest_first(statement, maps.c.id, _info, cursor=cursor, limit=limit)

    def next_version(self, level_id: str) -> int:
        """Number of the level's next version; the first is 1."""
        newest = self._read(select(func.max(maps.c.version)).where(maps.c.level_id == level_id)).scalar()
        return 1 if newest is None else newest + 1

    def paced_walks(self, level_id: str) -> AbstractSet[str]:
        """Ids of the walks whose stride the reports of the level's maps tell."""
        reports = self._read(select(maps.c.walks).where(maps.c.level_id == level_id)).scalars()
        return {walk["walk_id"] for walks in reports for walk in walks if walk.get("stride_scale") is not None}

    def load(self, map_id: str) -> GridMap:
        """Assemble a map from its tiles, its radio layer and its lines."""
        info = self.get(map_id)
        rows = self._read(
            select(map_tiles.c.row, map_tiles.c.column, tiles.c.data)
            .join(tiles, tiles.c.hash == map_tiles.c.tile_hash)
            .where(map_tiles.c.map_id == map_id)
        )
        radio: bytes | None = self._read(
            select(radio_layers.c.data).join(maps, maps.c.radio_hash == radio_layers.c.hash).where(maps.c.id == map_id)
        ).scalar()
        routes: bytes | None = self._read(
            select(route_layers.c.data).join(maps, maps.c.routes_hash == route_layers.c.hash).where(maps.c.id == map_id)
        ).scalar()
        header = header_from({name: getattr(info, name) for name in info.__slots__})
        return unpack_map(header, ((row.row, row.column, row.data) for row in rows), radio, routes)

    def _add_layer(self, table: Table, layer: PackedLayer | None) -> str | None:
        if layer is None:
            return None
        if self._read(select(table.c.hash).where(table.c.hash == layer.hash)).first() is None:
            self._write(insert(table).values(hash=layer.hash, data=layer.data))
        return layer.hash

    def _known(self, hashes: set[str]) -> set[str]:
        ordered = sorted(hashes)
        known: set[str] = set()
        for start in range(0, len(ordered), _KNOWN_CHUNK):
            chunk = ordered[start : start + _KNOWN_CHUNK]
            known.update(self._read(select(tiles.c.hash).where(tiles.c.hash.in_(chunk))).scalars())
        return known


def _settings(stored: dict[str, Any]) -> MapBuildSettings:
    extent = stored["extent"]
    return MapBuildSettings(
        **{
            **stored,
            "features": FeatureSet(stored["features"]),
            "extent": None if extent is None else tuple(extent),
        }
    )


def _place(map_id: str, tile: PackedTile) -> dict[str, Any]:
    return {"map_id": map_id, "row": tile.row, "column": tile.column, "tile_hash": tile.hash}


def _columns(info: MapInfo) -> dict[str, Any]:
    return {
        **{name: getattr(info, name) for name in _PLAIN},
        "features": info.features,
        "noise_sd": list(info.noise_sd),
        "field_sd": list(info.field_sd),
        "walks": [asdict(walk) for walk in info.walks],
        "origin": null() if info.origin is None else asdict(info.origin),
    }


def _info(row: Row[Any]) -> MapInfo:
    values = row._mapping
    return MapInfo(
        **{name: values[name] for name in _PLAIN},
        features=FeatureSet(values["features"]),
        noise_sd=tuple(values["noise_sd"]),
        field_sd=tuple(values["field_sd"]),
        walks=tuple(WalkReport(**{**walk, "offset": tuple(walk["offset"])}) for walk in values["walks"]),
        origin=_origin(values["origin"]),
    )


def _origin(stored: dict[str, Any] | None) -> MapOrigin | None:
    return None if stored is None else MapOrigin(**{**stored, "assumed": tuple(stored["assumed"])})
