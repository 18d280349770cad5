"""Maps and surveys as files: what goes out, and what comes in."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from datetime import datetime
from importlib.metadata import PackageNotFoundError, version
from typing import BinaryIO

import numpy as np

from app.engine.errors import InputError
from app.engine.mapping import FloorPlan
from app.engine.mapping.plan import obstacle_depth
from app.engine.types import GridMap, SurveyWalk
from app.exchange.maps import FORMATS, ImportChoices, ImportedMap, MapDocument, MapFormat, read_map, write_map
from app.exchange.maps.document import even_axis
from app.exchange.surveys.archive import survey_archive
from app.services.base import MAX_LIMIT, Service
from app.services.clock import Clock
from app.services.errors import InvalidError, NotFoundError
from app.services.ids import new_id
from app.services.map_refs import MapRefs
from app.services.ports import MapCache, UnitOfWorkFactory
from app.services.publishing import IMPORTED, publish
from app.services.records import Level, MapInfo, MapKind, MapOrigin, Survey, Venue

IMPORT = "import"
_MAX_TEXT = 500
_CONTROL = re.compile(r"[\x00-\x1f\x7f]+")


@dataclass(frozen=True, slots=True)
class FileTexts:
    """What a sender or receiver says about a file; empty: nothing."""

    title: str = ""
    licence: str = ""
    attribution: str = ""


NO_CHOICES, NO_TEXTS = ImportChoices(), FileTexts()


@dataclass(frozen=True, slots=True, eq=False)
class MapExport:
    """A map that is ready to be written: ``tag`` changes with every byte of the file."""

    document: MapDocument
    format: MapFormat
    file_name: str
    media_type: str
    tag: str

    def write(self, target: BinaryIO) -> None:
        """Write the file."""
        try:
            write_map(self.document, self.format, target)
        except InputError as error:
            raise refused(error) from error


class ExchangeService(Service):
    """Maps out and in, surveys out."""

    def __init__(self, *, uow: UnitOfWorkFactory, clock: Clock, cache: MapCache) -> None:
        super().__init__(uow=uow, clock=clock)
        self._cache = cache
        self._refs = MapRefs(uow=uow, cache=cache)

    def map_export(self, map_id: str, kind: MapFormat, licence: str = "") -> MapExport:
        """A map as a document; radio layer, survey lines and what the map knows about devices stay behind."""
        info = self._refs.info(map_id)
        with self._uow() as uow:
            level = uow.levels.get(info.level_id)
            venue = uow.venues.get(level.venue_id)
        document = _document(info, self._refs.grid(map_id), level, venue, licence)
        said = repr(sorted(document.attributes().items()))
        form = FORMATS[kind]
        return MapExport(
            document=document,
            format=kind,
            file_name=f"{map_id}-{kind.value}{form.suffix}",
            media_type=form.media_type,
            tag=hashlib.sha256(f"{kind.value} {said}".encode()).hexdigest()[:32],
        )

    def import_map(
        self,
        level_id: str,
        content: bytes,
        kind: MapFormat,
        *,
        choices: ImportChoices = NO_CHOICES,
        texts: FileTexts = NO_TEXTS,
        published: bool = True,
        key_id: str | None = None,
    ) -> MapInfo:
        """Store the map of a file as the level's next version, and make it the current one (``published``).

        InvalidError names what of the file cannot be taken.
        """
        with self._uow() as uow:
            level = uow.levels.get(level_id)
            drawn = uow.levels.vector_plan(level_id)
        try:
            imported = read_map(content, kind, level_id, choices)
        except InputError as error:
            raise refused(error) from error
        _check_place(imported.grid, level)
        grid = imported.grid if drawn is None else _with_plan(imported.grid, drawn)
        origin = _origin(imported, content, kind, texts)
        with self._uow() as uow:
            # compressing takes long: not while holding the write lock
            packed = uow.maps.pack(grid)
        now = self._clock()
        with self._uow(write=True) as uow:
            info = _map_info(
                imported, grid, origin, packed.hash, now=now, version=uow.maps.next_version(level_id),
                parent_id=uow.levels.get(level_id).current_map_id,
            )  # fmt: skip
            uow.maps.add(info, packed)
            if published:
                publish(uow, info, now, key_id=key_id, note=IMPORTED)
        self._cache.ref(info, lambda: grid)
        return info

    def survey_export(self, survey_id: str, *, radio: bool = False) -> tuple[Survey, Iterator[bytes]]:
        """A survey's walks as an archive, piece by piece; one walk is in memory at a time."""
        with self._uow() as uow:
            survey = uow.surveys.get(survey_id)
            level = uow.levels.get(survey.level_id)
            venue = uow.venues.get(level.venue_id)
        head = {"survey": survey.name, "level": level.name, "venue": venue.name, "software": software()}
        return survey, survey_archive(head, self._walks(survey_id), radio=radio)

    def _walks(self, survey_id: str) -> Iterator[tuple[str, SurveyWalk]]:
        cursor: str | None = None
        while True:
            with self._uow() as uow:
                page = uow.surveys.list_walks(survey_id, cursor=cursor, limit=MAX_LIMIT)
            for walk in page.items:
                try:
                    with self._uow() as uow:
                        recorded = uow.surveys.load_walk(walk.id)
                except NotFoundError:
                    continue  # deleted since the list was read
                yield walk.name, recorded  # outside the transaction: the receiver may be slow
            cursor = page.next_cursor
            if cursor is None:
                return


def software() -> str:
    """Name and version of this software."""
    try:
        return f"isodyn {version('isodyn')}"
    except PackageNotFoundError:
        return "isodyn (source tree)"


def refused(error: InputError) -> InvalidError:
    """What of a file cannot be taken: the engine's errors end in their remedy."""
    message, semicolon, remedy = error.message.rpartition("; ")
    if not semicolon:
        return InvalidError(error.field, error.message, "correct the file, see docs/exchange.md")
    return InvalidError(error.field, message, remedy)


def _document(info: MapInfo, grid: GridMap, level: Level, venue: Venue, licence: str) -> MapDocument:
    origin = info.origin
    done = f"{info.created_at:%Y-%m-%dT%H:%M:%SZ}"
    if origin is None:
        history = f"{done} map version {info.version} built from {info.n_walks} survey walks, {info.n_samples} samples"
    else:
        history = f"{done} map version {info.version} imported from {origin.format}, sha256 {origin.file_hash}"
    return MapDocument(
        grid=grid,
        title=f"Magnetic map of {venue.name}, {level.name}",
        history=history,
        licence=licence or ("" if origin is None else origin.licence),
        attribution="" if origin is None else origin.attribution,
        map_id=info.id,
        version=info.version,
        content_hash=info.hash,
        length_scale_m=info.length_scale_m,
        field_sd=info.field_sd,
        software=software(),
        plane=None if venue.anchor is None else venue.anchor.plane(),
    )


def _check_place(grid: GridMap, level: Level) -> None:
    """Refuse a map of somewhere else: most likely its coordinates are no level metres."""
    x_min, y_min, x_max, y_max = grid.extent
    left, low, right, high = level.extent
    if x_max < left or x_min > right or y_max < low or y_min > high:
        raise InvalidError(
            "file",
            f"lies at x {x_min:g} to {x_max:g}, y {y_min:g} to {y_max:g}, outside the level "
            f"({left:g} to {right:g}, {low:g} to {high:g})",
            "send a grid in metres of the level frame",
        )


def _with_plan(grid: GridMap, drawn: bytes) -> GridMap:
    """A map whose file says nothing of walls takes them from the level's plan, as a built one does."""
    if grid.obstacle is not None:
        return grid
    x, y = (even_axis(first, grid.cell_m, n) for first, n in ((grid.x0, grid.shape[1]), (grid.y0, grid.shape[0])))
    row, column = np.nonzero(grid.mapped)
    walked = np.stack([x[column], y[row]], axis=1)
    depth = obstacle_depth(FloorPlan.from_geojson(json.loads(drawn)), walked, x, y)
    return replace(grid, obstacle=depth.astype(np.float32))


def _origin(imported: ImportedMap, content: bytes, kind: MapFormat, texts: FileTexts) -> MapOrigin:
    """The sender's words win over the file's."""

    def text(given: str, *names: str) -> str:
        found = next((one for name in names if isinstance(one := imported.attributes.get(name), str)), "")
        return _CONTROL.sub(" ", given or found).strip()[:_MAX_TEXT]

    return MapOrigin(
        source=IMPORT,
        format=kind.value,
        file_hash=hashlib.sha256(content).hexdigest(),
        title=text(texts.title, "title"),
        licence=text(texts.licence, "licence", "license"),
        attribution=text(texts.attribution, "attribution", "institution", "references"),
        assumed=imported.assumed,
    )


def _map_info(
    imported: ImportedMap,
    grid: GridMap,
    origin: MapOrigin,
    content_hash: str,
    *,
    now: datetime,
    version: int,
    parent_id: str | None,
) -> MapInfo:
    rows, columns = grid.shape
    mapped = grid.mapped
    return MapInfo(
        id=new_id("map", now),
        level_id=grid.level_id,
        version=version,
        parent_id=parent_id,
        hash=content_hash,
        features=grid.features,
        x0=grid.x0,
        y0=grid.y0,
        cell_m=grid.cell_m,
        rows=rows,
        columns=columns,
        mapped_m=grid.mapped_m,
        noise_sd=grid.noise_sd,
        mapped_share=float(mapped.mean()),
        mapped_area_m2=float(mapped.sum()) * grid.cell_m**2,
        n_walks=0,
        n_samples=0,
        length_scale_m=imported.length_scale_m,
        field_sd=imported.field_sd,
        walks=(),
        build_s=0.0,
        created_at=now,
        has_obstacle=grid.obstacle is not None,
        origin=origin,
        kind=MapKind.IMPORT,
    )
