"""Map versions, their tiles, and the requests to build them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import asdict, replace
from typing import Any

from sqlalchemy import Column, ColumnElement, Row, Table, func, insert, literal, not_, null, select, update

from app.engine.types import Evidence, FeatureSet, GridMap, MapBuildSettings, WalkReport
from app.services.ports import Box
from app.services.records import (
    JobKind,
    JobState,
    MapInfo,
    MapKind,
    MapOrigin,
    NewBuild,
    PackedLayer,
    PackedMap,
    PackedTile,
    Page,
)
from app.storage.evidence import pack_evidence, tiles_in, unpack_evidence
from app.storage.models import (
    evidence_tiles,
    jobs,
    map_builds,
    map_evidence,
    map_tiles,
    maps,
    radio_layers,
    route_layers,
    tiles,
)
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
        "kind",
        "model",
    ),
)
_KNOWN_CHUNK = 500  # parameters of one IN list; SQLite takes at least 999


class SqlMapRepository(Repository):
    """Port ``MapRepository``."""

    def add_build(self, job_id: str, build: NewBuild) -> None:
        """Note what a build job is to build."""
        self._write(
            insert(map_builds).values(
                job_id=job_id,
                level_id=build.level_id,
                settings=asdict(build.settings),
                survey_ids=list(build.survey_ids),
                mode=build.mode,
                publish=build.publish,
                key_id=build.key_id,
            )
        )

    def get_build(self, job_id: str) -> NewBuild:
        """What a build job is to build."""
        return _build(self._one("map build", job_id, select(map_builds).where(map_builds.c.job_id == job_id)))

    def finish_build(self, job_id: str, map_id: str) -> None:
        """Note which map came of a build."""
        self._write(update(map_builds).where(map_builds.c.job_id == job_id).values(map_id=map_id))

    def awaits_build(self, level_id: str) -> bool:
        """Whether a build or update of the level waits that nobody has begun, other than of a draft."""
        ordered = select(jobs.c.id).join(map_builds, map_builds.c.job_id == jobs.c.id).where(
            jobs.c.state == JobState.QUEUED,
            jobs.c.kind == JobKind.BUILD_MAP,
            jobs.c.order_key == level_id,
            map_builds.c.publish,
        )  # fmt: skip
        return self._read(ordered.limit(1)).first() is not None

    def build_of(self, map_id: str) -> NewBuild | None:
        """The build that a map came of; None for those of before this was noted, and for maps that were not built."""
        row = self._read(select(map_builds).where(map_builds.c.map_id == map_id)).one_or_none()
        return None if row is None else _build(row)

    def tile_hashes(self, map_id: str) -> Sequence[str]:
        """Content hashes of a map's tiles, row by row."""
        ordered = select(map_tiles.c.tile_hash).order_by(map_tiles.c.row, map_tiles.c.column)
        return self._read(ordered.where(map_tiles.c.map_id == map_id)).scalars().all()

    def pack(self, grid_map: GridMap, evidence: Evidence | None = None) -> PackedMap:
        """Cut into tiles, compress and hash; touches no table."""
        packed = pack_map(grid_map)
        return packed if evidence is None else replace(packed, evidence=pack_evidence(evidence))

    def add(self, info: MapInfo, packed: PackedMap, *, keep: Box | None = None) -> None:
        """Store a map version; tiles and layers that an earlier version has are shared."""
        self._add_tiles(tiles, packed.tiles)
        self._add_tiles(evidence_tiles, packed.evidence)
        radio_hash = self._add_layer(radio_layers, packed.radio)
        routes_hash = self._add_layer(route_layers, packed.routes)
        self._write(insert(maps).values(**_columns(info), radio_hash=radio_hash, routes_hash=routes_hash))
        self._write(insert(map_tiles), [_place(info.id, tile) for tile in packed.tiles])
        if packed.evidence:
            self._write(insert(map_evidence), [_place(info.id, tile) for tile in packed.evidence])
        if keep is not None and info.parent_id is not None:
            self._keep_evidence(info.id, info.parent_id, keep)

    def evidence(self, map_id: str, box: Box | None = None) -> Evidence | None:
        """What a map rests on."""
        info = self.get(map_id)
        if info.model is None:
            return None
        statement = select(evidence_tiles.c.data).join(map_evidence, evidence_tiles.c.hash == map_evidence.c.tile_hash)
        statement = statement.where(map_evidence.c.map_id == map_id)
        if box is not None:
            statement = statement.where(_inside(box))
        ordered = statement.order_by(map_evidence.c.row, map_evidence.c.column)
        return unpack_evidence(info.features, self._read(ordered).scalars())

    def sources(self, map_id: str) -> AbstractSet[str]:
        """Ids of all walks and contributions that went into a version, or were found unfit for it."""
        known: set[str] = set()
        gone: set[str] = set()
        for version in self._chain(
            map_id, maps.c.added, maps.c.removed
        ):  # from the newest back, so that what was taken out and added again counts
            known |= set(version.added or ()) - gone
            gone |= set(version.removed or ()) - known
        return known

    def reports(self, map_id: str) -> Mapping[str, WalkReport]:
        """Reports about the walks of a version by walk id: of its build, and of the updates since."""
        reports: dict[str, WalkReport] = {}
        for version in reversed(self._chain(map_id, maps.c.removed, maps.c.walks)):
            for walk_id in version.removed or ():
                reports.pop(walk_id, None)
            reports |= {report.walk_id: report for report in map(_report, version.walks)}
        return reports

    def _chain(self, map_id: str, *columns: Column[Any]) -> Sequence[Row[Any]]:
        """Columns of a version, of those that it is an update of, and of the build they began with; newest first."""
        first = select(maps.c.id, maps.c.parent_id, maps.c.kind, literal(0).label("depth")).where(maps.c.id == map_id)
        chain = first.cte("chain", recursive=True)
        before = select(maps.c.id, maps.c.parent_id, maps.c.kind, (chain.c.depth + 1).label("depth"))
        chain = chain.union_all(
            before.join(chain, maps.c.id == chain.c.parent_id).where(chain.c.kind == MapKind.UPDATE)
        )
        wanted = select(*columns).join(chain, chain.c.id == maps.c.id)
        rows = self._read(wanted.order_by(chain.c.depth)).all()
        if not rows:
            self.get(map_id)  # NotFoundError
        return rows

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

    def _add_tiles(self, table: Table, packed: Sequence[PackedTile]) -> None:
        known = self._known(table, {tile.hash for tile in packed})
        fresh = {tile.hash: tile for tile in packed if tile.hash not in known}
        if fresh:
            self._write(insert(table), [{"hash": tile.hash, "data": tile.data} for tile in fresh.values()])

    def _keep_evidence(self, map_id: str, parent_id: str, box: Box) -> None:
        """The parent's tiles outside of the box, which an update has not touched."""
        columns = (map_evidence.c.row, map_evidence.c.column, map_evidence.c.tile_hash)
        kept = select(literal(map_id), *columns).where(map_evidence.c.map_id == parent_id, not_(_inside(box)))
        self._write(insert(map_evidence).from_select(["map_id", "row", "column", "tile_hash"], kept))

    def _add_layer(self, table: Table, layer: PackedLayer | None) -> str | None:
        if layer is None:
            return None
        if self._read(select(table.c.hash).where(table.c.hash == layer.hash)).first() is None:
            self._write(insert(table).values(hash=layer.hash, data=layer.data))
        return layer.hash

    def _known(self, table: Table, hashes: set[str]) -> set[str]:
        ordered = sorted(hashes)
        known: set[str] = set()
        for start in range(0, len(ordered), _KNOWN_CHUNK):
            chunk = ordered[start : start + _KNOWN_CHUNK]
            known.update(self._read(select(table.c.hash).where(table.c.hash.in_(chunk))).scalars())
        return known


def _build(row: Row[Any]) -> NewBuild:
    return NewBuild(
        level_id=row.level_id,
        settings=_settings(row.settings),
        survey_ids=tuple(row.survey_ids),
        mode=MapKind(row.mode),
        publish=row.publish,
        key_id=row.key_id,
    )


def _inside(box: Box) -> ColumnElement[bool]:
    rows, columns = tiles_in(box)
    return map_evidence.c.row.between(rows[0], rows[-1]) & map_evidence.c.column.between(columns[0], columns[-1])


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
        "added": list(info.added),
        "removed": list(info.removed),
        "walks": [asdict(walk) for walk in info.walks],
        "origin": null() if info.origin is None else asdict(info.origin),
    }


def _info(row: Row[Any]) -> MapInfo:
    values = row._mapping
    return MapInfo(
        **{name: values[name] for name in _PLAIN if name != "kind"},
        kind=MapKind(values["kind"]),
        added=tuple(values["added"] or ()),
        removed=tuple(values["removed"] or ()),
        features=FeatureSet(values["features"]),
        noise_sd=tuple(values["noise_sd"]),
        field_sd=tuple(values["field_sd"]),
        walks=tuple(map(_report, values["walks"])),
        origin=_origin(values["origin"]),
    )


def _report(stored: dict[str, Any]) -> WalkReport:
    return WalkReport(**{**stored, "offset": tuple(stored["offset"])})


def _origin(stored: dict[str, Any] | None) -> MapOrigin | None:
    return None if stored is None else MapOrigin(**{**stored, "assumed": tuple(stored["assumed"])})
