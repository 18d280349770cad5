"""What venues and levels share: they have names and lie somewhere on earth."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

from sqlalchemy import Column, ColumnElement, Row, Select, Table, and_, delete, exists, func, insert, or_, select

from app.services.records import Found, Page
from app.services.search import Search
from app.services.search import name_words as words_of
from app.storage.models import name_words
from app.storage.places import begins, from_near_cursor, near_cursor, squared_distance, touches
from app.storage.repositories.base import Repository, page

T = TypeVar("T")
_FREQUENT = 500
"""Rows with a word are counted so far: a list of more is not made before the page is known."""


class PlacedRepository(Repository):
    """Queries by place and name."""

    def _find(
        self,
        statement: Select[Any],
        table: Table,
        record: Callable[[Row[Any]], T],
        search: Search,
        *,
        cursor: str | None,
        limit: int,
    ) -> Page[Found[T]]:
        """Page of what a search finds."""
        statement = statement.where(*self._named(table.c.id, search.words))
        if search.area is not None:
            statement = statement.where(touches(table, search.area))
        if search.near is None:
            return self._newest_first(statement, table.c.id, lambda row: Found(record(row)), cursor=cursor, limit=limit)
        squared = squared_distance(table, search.near).label("squared_m2")
        statement = statement.add_columns(squared).where(squared <= search.near.radius_m**2)
        if cursor is not None:
            last, last_id = from_near_cursor(cursor)
            statement = statement.where(or_(squared > last, and_(squared == last, table.c.id > last_id)))
        rows = self._read(statement.order_by(squared, table.c.id).limit(limit + 1)).all()
        return page(
            rows,
            lambda row: Found(record(row), math.sqrt(row.squared_m2)),
            lambda row: near_cursor(row.squared_m2, row.id),
            limit=limit,
        )

    def _named(self, id_: Column[str], words: Sequence[str]) -> list[ColumnElement[bool]]:
        """Conditions that each of these begins a word of the row's name.

        The rarest word leads to the rows, the others are looked up for each. If all are frequent, the list is gone
        through in its own order instead: its page is soon full.
        """
        if not words:
            return []
        owner = name_words.c.owner_id
        seen = {word: self._read(_count(word)).scalar_one() for word in words}
        rarest = min(words, key=lambda word: seen[word])
        found: list[ColumnElement[bool]] = [
            exists().where(owner == id_, begins(word)) for word in words if word != rarest or seen[word] == _FREQUENT
        ]
        return found if seen[rarest] == _FREQUENT else [id_.in_(select(owner).where(begins(rarest))), *found]

    def _set_words(self, owner_id: str, *names: str) -> None:
        """Let a row be found by the words of these names, and by no others."""
        self._write(delete(name_words).where(name_words.c.owner_id == owner_id))
        words = words_of(" ".join(names))
        if words:
            self._write(insert(name_words), [{"word": word, "owner_id": owner_id} for word in words])


def _count(word: str) -> Select[Any]:
    some = select(name_words.c.owner_id).where(begins(word)).limit(_FREQUENT)
    return select(func.count()).select_from(some.subquery())
