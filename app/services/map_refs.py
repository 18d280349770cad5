"""Where a map lies in the local cache: shared by the use cases that hand maps to workers."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

from app.engine.types import GridMap
from app.services.ports import MapCache, UnitOfWorkFactory
from app.services.records import LevelMap, MapInfo
from app.services.tasks import MapRef

_KEPT = 256


class MapRefs:
    """Looks up map versions (which never change, so their headers are kept) and fills the cache."""

    def __init__(self, *, uow: UnitOfWorkFactory, cache: MapCache) -> None:
        self._uow = uow
        self._cache = cache
        self._info = lru_cache(maxsize=_KEPT)(self._read_info)

    def info(self, map_id: str) -> MapInfo:
        """Header of a map; NotFoundError if there is none."""
        return self._info(map_id)

    def ref(self, map_id: str) -> MapRef:
        """File of a map in the cache, filled from the database if it is missing."""
        return self._cache.ref(self._info(map_id), lambda: self._load(map_id))

    def refs(self, maps: Sequence[LevelMap]) -> tuple[MapRef, ...]:
        """Files of the maps of a trip, in this order."""
        return tuple(self.ref(one.map_id) for one in maps)

    def grid(self, map_id: str) -> GridMap:
        """The map itself, memory-mapped."""
        return self._cache.open(self.ref(map_id))

    def _read_info(self, map_id: str) -> MapInfo:
        with self._uow() as uow:
            return uow.maps.get(map_id)

    def _load(self, map_id: str) -> GridMap:
        with self._uow() as uow:
            return uow.maps.load(map_id)
