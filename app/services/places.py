"""Where a trip takes place: on one level, or on any level of a venue; and the maps that are pinned for it."""

from __future__ import annotations

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


def choose_place(uow: UnitOfWork, level_id: str | None, venue_id: str | None, map_id: str | None) -> Place:
    """The named level with its current map or the named one, or the venue with all its current maps.

    Raises
    ------
    InvalidError
        Not exactly one of level and venue; a map of another level; a map for a venue.
    NoMapError
        There is no map to use.
    """
    if venue_id is None:
        if level_id is None:
            raise InvalidError(
                "level_id", "is missing, and so is venue_id", "send level_id, or venue_id for any level of a venue"
            )
        return _on_level(uow, level_id, map_id)
    if level_id is not None:
        raise InvalidError("venue_id", "is sent beside level_id", "send one of the two: a level is of one venue")
    if map_id is not None:
        raise InvalidError("map_id", "is a map of one level", "send the level_id, or leave map_id out")
    return _in_venue(uow, venue_id)


def _on_level(uow: UnitOfWork, level_id: str, map_id: str | None) -> Place:
    level = uow.levels.get(level_id)
    if map_id is None:
        map_id = level.current_map_id
        if map_id is None:
            raise NoMapError(level_id=level_id)
    elif uow.maps.get(map_id).level_id != level_id:
        raise InvalidError("map_id", f"map {map_id} is of another level", f"name a map of level {level_id}")
    return Place(level.venue_id, level_id, (LevelMap(level_id, map_id),))


def _in_venue(uow: UnitOfWork, venue_id: str) -> Place:
    uow.venues.get(venue_id)
    maps = uow.levels.current_maps(venue_id, limit=MAX_LEVELS + 1)
    if not maps:
        raise NoMapError(venue_id=venue_id)
    if len(maps) > MAX_LEVELS:
        raise InvalidError("venue_id", f"has more than {MAX_LEVELS} levels with a map", "send the level_id")
    return Place(venue_id, None, tuple(maps))
