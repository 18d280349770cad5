"""Versions of a level's map: which one is published and was before, who contributed to it, what changed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from functools import lru_cache

import numpy as np

from app.engine.errors import InputError
from app.engine.mapping.diff import COMPONENTS, LEAST_UT, Component, MapDifference, diff_maps
from app.engine.types import Evidence, SourceKind, WalkReport
from app.services.base import DEFAULT_LIMIT, Service, check_limit, check_number_cursor
from app.services.clock import Clock
from app.services.errors import InvalidError
from app.services.map_refs import MapRefs
from app.services.ports import MapCache, UnitOfWork, UnitOfWorkFactory
from app.services.publishing import publish
from app.services.records import (
    Change,
    ChangeRaster,
    MapInfo,
    MapSource,
    NewBuild,
    Page,
    Publication,
    SettingChange,
    TileCounts,
    VersionDiff,
    Walk,
)

_KEPT = 8
"""Versions whose sources are remembered: a list is read page by page, and its evidence is large."""


class VersionService(Service):
    """Publish versions and compare them."""

    def __init__(self, *, uow: UnitOfWorkFactory, clock: Clock, cache: MapCache) -> None:
        super().__init__(uow=uow, clock=clock)
        self._refs = MapRefs(uow=uow, cache=cache)
        self._sources = lru_cache(maxsize=_KEPT)(self._read_sources)

    def publish(self, level_id: str, map_id: str, *, key_id: str | None = None, note: str = "") -> Publication:
        """Make a version the one that new sessions on the level use; an older one too: that is rolling back.

        Sessions that are open stay on the version they were opened with. Publishing what is current changes nothing.
        """
        now = self._clock()
        with self._uow(write=True) as uow:
            uow.levels.get(level_id)
            info = uow.maps.get(map_id)
            if info.level_id != level_id:
                raise InvalidError(
                    "map_id", f"map {map_id} is of another level", f"name a map of level {level_id}: GET /v1/maps"
                )
            return publish(uow, info, now, key_id=key_id, note=note)

    def publications(self, level_id: str, cursor: str | None = None, limit: int = DEFAULT_LIMIT) -> Page[Publication]:
        """What was published on a level, newest first."""
        with self._uow() as uow:
            uow.levels.get(level_id)
            return uow.publications.list(level_id, cursor=cursor, limit=check_limit(limit))

    def sources(self, map_id: str, cursor: str | None = None, limit: int = DEFAULT_LIMIT) -> Page[MapSource]:
        """Who contributed to a version: the sources of its evidence, then walks that were left out.

        The cursor counts them. The survey is that of the walk as it is stored now; a walk deleted since has none.
        """
        first = int(check_number_cursor(cursor) or 0)
        last = first + check_limit(limit)
        known = self._sources(map_id)
        shown = known[first:last]
        with self._uow() as uow:
            walks = uow.surveys.find_walks([source.id for source in shown if source.kind is SourceKind.SURVEY])
        items = (_with_walk(source, walks[source.id]) if source.id in walks else source for source in shown)
        return Page(tuple(items), str(last) if last < len(known) else None)

    def compared(self, map_id: str, against: str | None = None) -> tuple[MapInfo, MapInfo]:
        """The version and the one it is compared with: its parent, unless one is named."""
        info = self._refs.info(map_id)
        other = info.parent_id if against is None else against
        if other is None:
            raise InvalidError("against", f"is missing, and map {map_id} has no parent", _remedy(info))
        then = self._refs.info(other)
        if then.level_id != info.level_id:
            raise InvalidError("against", f"map {other} is of another level", _remedy(info))
        return info, then

    def difference(self, now: MapInfo, then: MapInfo) -> MapDifference:
        """Two versions side by side; InvalidError if their nodes do not coincide."""
        try:
            return diff_maps(self._refs.grid(now.id), self._refs.grid(then.id))
        except InputError as error:
            raise InvalidError("against", str(error), _remedy(now)) from error

    def change(self, now: MapInfo, then: MapInfo, component: Component, *, significance: bool) -> ChangeRaster:
        """Change of a component, or its significance, on the nodes of both versions; NaN where one is not mapped."""
        difference = self.difference(now, then)
        if component not in COMPONENTS[difference.features]:
            shown = ", ".join(COMPONENTS[difference.features])
            message = f"versions compared as {difference.features!s} do not tell {component!s}"
            raise InvalidError("component", message, f"choose one of: {shown}")
        values = difference.significance(component) if significance else difference.change(component)
        return ChangeRaster(values, difference.x0, difference.y0, difference.cell_m)

    def diff(self, map_id: str, against: str | None = None, *, least_ut: float = LEAST_UT) -> VersionDiff:
        """What a version changed against its parent (or the named one), in numbers."""
        now, then = self.compared(map_id, against)
        summary = self.difference(now, then).summary(least_ut)
        with self._uow() as uow:
            tiles, settings = _tiles(uow, now, then), _settings(uow, now, then)
        own, other = (_in_use(self._sources(info.id)) for info in (now, then))
        return VersionDiff(
            map_id=now.id,
            against=then.id,
            identical=now.hash == then.hash,
            field=summary,
            tiles=tiles,
            sources=Change(_lacking(own, other), _lacking(other, own)),
            settings=settings,
        )

    def _read_sources(self, map_id: str) -> tuple[MapSource, ...]:
        with self._uow() as uow:
            return _sources_of(uow.maps.evidence(map_id), uow.maps.reports(map_id))


def _remedy(info: MapInfo) -> str:
    return f"name a version of level {info.level_id} with a cell_m of {info.cell_m:g}: GET /v1/maps?level_id="


def _sources_of(evidence: Evidence | None, reports: Mapping[str, WalkReport]) -> tuple[MapSource, ...]:
    if evidence is None:  # of before it was kept
        return tuple(_of_report(report) for report in reports.values())
    n = len(evidence.sources)
    counts = np.bincount(evidence.source, minlength=n).tolist()
    used = np.bincount(evidence.source, weights=evidence.weight > 0, minlength=n).astype(int).tolist()
    brought = tuple(
        MapSource(
            id=source.id,
            kind=source.kind,
            survey_id=None,
            device_id=source.device or None,
            contributor=source.contributor or None,
            n_samples=counts[i],
            n_used=used[i],
            rejected=None,
        )
        for i, source in enumerate(evidence.sources)
    )
    return brought + tuple(_of_report(report) for report in reports.values() if report.rejected is not None)


def _of_report(report: WalkReport) -> MapSource:
    return MapSource(
        id=report.walk_id,
        kind=SourceKind.SURVEY,
        survey_id=None,
        device_id=None,
        contributor=None,
        n_samples=None,
        n_used=None,
        rejected=report.rejected,
    )


def _with_walk(source: MapSource, walk: Walk) -> MapSource:
    return replace(source, survey_id=walk.survey_id, device_id=source.device_id or walk.device_id)


def _in_use(sources: Sequence[MapSource]) -> dict[str, None]:
    """Ids of the sources that a version rests on, in their order."""
    return {source.id: None for source in sources if source.rejected is None}


def _lacking(own: Mapping[str, None], other: Mapping[str, None]) -> tuple[str, ...]:
    return tuple(one for one in own if one not in other)


def _tiles(uow: UnitOfWork, now: MapInfo, then: MapInfo) -> TileCounts:
    own, other = (uow.maps.tile_hashes(info.id) for info in (now, then))
    known, kept = set(other), set(own)
    shared = sum(one in known for one in own)
    return TileCounts(shared=shared, new=len(own) - shared, gone=sum(one not in kept for one in other))


def _settings(uow: UnitOfWork, now: MapInfo, then: MapInfo) -> tuple[SettingChange, ...]:
    """Settings that differ; of versions whose order is not known, those that the maps show themselves."""
    values, before = (_settings_of(info, uow.maps.build_of(info.id)) for info in (now, then))
    both = [name for name in values if name in before]
    return tuple(SettingChange(name, values[name], before[name]) for name in both if values[name] != before[name])


def _settings_of(info: MapInfo, build: NewBuild | None) -> dict[str, object]:
    shown: dict[str, object] = {"features": info.features.value, "cell_m": info.cell_m, "mapped_m": info.mapped_m}
    if build is None:
        return shown
    return asdict(build.settings) | shown | {"survey_ids": build.survey_ids}
