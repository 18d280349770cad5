"""Finding venues and levels: near a place, in a box, by the words of a name, by storey."""

from __future__ import annotations

import re
import unicodedata
from dataclasses import dataclass

from app.engine.geodesy import GeoBox
from app.services.base import DEFAULT_LIMIT, Service, check_limit
from app.services.errors import InvalidError
from app.services.records import Found, Level, Page, Venue

MAX_RADIUS_M = 50_000.0
"""Distances are measured on a plane at the place asked for; up to here that errs by 2 % at 60 degrees north, and more
nearer to a pole."""
DEFAULT_RADIUS_M = 1_000.0
MAX_QUERY_WORDS = 8
MAX_NAME_WORDS = 32
MAX_WORD = 64
_WORD = re.compile(r"\w+")


@dataclass(frozen=True, slots=True)
class Near:
    """A disc on the ellipsoid, WGS 84."""

    latitude_deg: float
    longitude_deg: float
    radius_m: float = DEFAULT_RADIUS_M

    def box(self) -> GeoBox:
        """The box that holds it."""
        return GeoBox.around(self.latitude_deg, self.longitude_deg, self.radius_m)


@dataclass(frozen=True, slots=True)
class Search:
    """What is looked for; what is not set does not matter.

    Attributes
    ----------
    near : Near or None
        Nearest first; without it lists are newest first.
    box : GeoBox or None
    words : tuple of str
        Each begins a word of the name (of a level: or of its venue's).
    ordinal : int or None
        Of levels.
    """

    near: Near | None = None
    box: GeoBox | None = None
    words: tuple[str, ...] = ()
    ordinal: int | None = None

    def __post_init__(self) -> None:
        if self.near is not None and self.box is not None:
            raise InvalidError("bbox", "is sent beside near", "send one of the two")
        if self.near is not None and not 0.0 < self.near.radius_m <= MAX_RADIUS_M:
            raise InvalidError("radius_m", f"{self.near.radius_m:g} is out of range", f"give at most {MAX_RADIUS_M:g}")

    @property
    def area(self) -> GeoBox | None:
        """The box that everything found touches."""
        return self.box if self.near is None else self.near.box()


EVERYTHING = Search()


def name_words(text: str, limit: int = MAX_NAME_WORDS) -> tuple[str, ...]:
    """Words of a name as they are compared: compatibility forms and case folded, each once."""
    words = _WORD.findall(unicodedata.normalize("NFKC", text).casefold())
    return tuple(dict.fromkeys(word[:MAX_WORD] for word in words))[:limit]


def query_words(text: str) -> tuple[str, ...]:
    """Words that a name is to have, or begin like; InvalidError without any."""
    words = name_words(text, MAX_QUERY_WORDS)
    if not words:
        raise InvalidError("q", "holds no letter or digit", "send the beginning of a word of the name")
    return words


class SearchService(Service):
    """Lists of venues and levels."""

    def venues(
        self, search: Search = EVERYTHING, cursor: str | None = None, limit: int = DEFAULT_LIMIT
    ) -> Page[Found[Venue]]:
        """Venues: nearest first where a place is named, else newest first.

        A venue without an anchor is nowhere on earth, so it is not found by place.
        """
        with self._uow() as uow:
            return uow.venues.find(search, cursor=cursor, limit=check_limit(limit))

    def levels(
        self,
        search: Search = EVERYTHING,
        venue_id: str | None = None,
        cursor: str | None = None,
        limit: int = DEFAULT_LIMIT,
    ) -> Page[Found[Level]]:
        """Levels, of one venue if it is named: nearest first where a place is named, else newest first."""
        with self._uow() as uow:
            if venue_id is not None:
                uow.venues.get(venue_id)
            return uow.levels.find(search, venue_id=venue_id, cursor=cursor, limit=check_limit(limit))
