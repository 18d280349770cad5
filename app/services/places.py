"""Where a trip takes place: on one level, or on any level of a venue; and the maps that are pinned for it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from app.engine.types import Prior
from app.services.errors import InvalidError, NoMapError
from app.services.ports import UnitOfWork
from app.services.records import LevelMap

MAX_LEVELS = 64
"""A worker searches all levels of a trip with its first segments: more than this is not a building."""


@dataclass(frozen=True, slots=True)
class Place:
    """A level (``level_id``), or a venue whose level is not known (``level_id`` None), with its maps."""

    venue_id: str
    level_id: str | None
    maps: tuple[LevelMap, ...]

    def prior(self, prior: Prior | None) -> Prior:
        """The prior, on this place; InvalidError for a position on a level that nobody knows."""
        if prior is None:
            return Prior(self.level_id)
        if self.level_id is None and prior.x is not None:
            raise InvalidError("prior.x", "means nothing without a level", "send level_id, or leave x and y out")
        return replace(prior, level_id=self.level_id)


def choose_place(
    uow: UnitOfWork, level_id: str | None, venue_id: str | None, map_id: str | None, map_ids: Sequence[str] = ()
) -> Place:
    """The named level with its current map or the named one, or the venue with all its current maps.

    ``map_ids`` are versions to use in place of the current ones, at most one a level.

    Raises
    ------
    InvalidError
        Not exactly one of level and venue; a map of another level or venue; one map for a venue; two for a level.
    NoMapError
        There is no map to use.
    """
    named = named_maps(map_id, map_ids)
    if venue_id is None:
        if level_id is None:
            raise InvalidError(
                "level_id", "is missing, and so is venue_id", "send level_id, or venue_id for any level of a venue"
            )
        if len(map_ids) > 1:
            raise InvalidError("map_ids", f"names {len(map_ids)} maps for one level", "name one map of the level")
        return _on_level(uow, level_id, named[0] if named else None)
    if level_id is not None:
        raise InvalidError("venue_id", "is sent beside level_id", "send one of the two: a level is of one venue")
    if map_id is not None:
        raise InvalidError("map_id", "is a map of one level", "send the level_id, or map_ids, one a level")
    return _in_venue(uow, venue_id, named)


@dataclass(frozen=True, slots=True)
class NamedMap:
    """A map that a request names, and in which field."""

    field: str
    map_id: str


def named_maps(map_id: str | None, map_ids: Sequence[str]) -> tuple[NamedMap, ...]:
    """The maps that a request names, in one of the two ways; InvalidError if in both."""
    if map_id is None:
        return tuple(NamedMap(f"map_ids.{i}", one) for i, one in enumerate(map_ids))
    if map_ids:
        raise InvalidError("map_ids", "is sent beside map_id", "send one of the two: map_ids may name one map")
    return (NamedMap("map_id", map_id),)


def _on_level(uow: UnitOfWork, level_id: str, named: NamedMap | None) -> Place:
    level = uow.levels.get(level_id)
    if named is None:
        if level.current_map_id is None:
            raise NoMapError(level_id=level_id)
        return Place(level.venue_id, level_id, (LevelMap(level_id, level.current_map_id),))
    if uow.maps.get(named.map_id).level_id != level_id:
        raise InvalidError(named.field, f"map {named.map_id} is of another level", f"name a map of level {level_id}")
    return Place(level.venue_id, level_id, (LevelMap(level_id, named.map_id),))


def chosen_maps(uow: UnitOfWork, venue_id: str, named: Sequence[NamedMap]) -> dict[str, str]:
    """The named maps by level; InvalidError unless each is of another level of the venue."""
    chosen: dict[str, str] = {}
    for one in named:
        level_id = uow.maps.get(one.map_id).level_id
        if uow.levels.get(level_id).venue_id != venue_id:
            remedy = f"name maps of levels of venue {venue_id}"
            raise InvalidError(one.field, f"map {one.map_id} is of another venue", remedy)
        if level_id in chosen:
            raise InvalidError(one.field, f"is the second map of level {level_id}", "name at most one of each level")
        chosen[level_id] = one.map_id
    return chosen


def _in_venue(uow: UnitOfWork, venue_id: str, named: Sequence[NamedMap]) -> Place:
    uow.venues.get(venue_id)
    maps = with_maps(uow, uow.levels.current_maps(venue_id, limit=MAX_LEVELS + 1), chosen_maps(uow, venue_id, named))
    if not maps:
        raise NoMapError(venue_id=venue_id)
    if len(maps) > MAX_LEVELS:
        raise InvalidError("venue_id", f"has more than {MAX_LEVELS} levels with a map", "send the level_id")
    return Place(venue_id, None, maps)


def with_maps(uow: UnitOfWork, maps: Sequence[LevelMap], chosen: Mapping[str, str]) -> tuple[LevelMap, ...]:
    """These maps with the chosen ones in place of others of their levels, lowest level first."""
    if not chosen:
        return tuple(maps)
    by_level = {one.level_id: one.map_id for one in maps} | dict(chosen)
    ordinals = {level_id: uow.levels.get(level_id).ordinal for level_id in by_level}
    return tuple(LevelMap(i, by_level[i]) for i in sorted(by_level, key=lambda i: (ordinals[i], i)))
