"""What all repositories share."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

from sqlalchemy import Column, Connection, CursorResult, Executable, Row, Select

from app.services.errors import NotFoundError
from app.services.records import Page

T = TypeVar("T")
Values = Mapping[str, Any]


class ReadOnlyTransactionError(RuntimeError):
    """A use case wrote in a transaction it opened for reading."""


class Repository:
    """Queries over one connection, inside its transaction."""

    def __init__(self, connection: Connection, *, writable: bool) -> None:
        self._connection = connection
        self._writable = writable

    def _read(self, statement: Executable, values: Values | None = None) -> CursorResult[Any]:
        return self._connection.execute(statement, values)

    def _write(self, statement: Executable, values: Values | Sequence[Values] | None = None) -> CursorResult[Any]:
        if not self._writable:
            # on SQLite this would work until the first time that somebody else wrote in between
            raise ReadOnlyTransactionError("open the unit of work with write=True")
        return self._connection.execute(statement, values)

    def _one(self, kind: str, id_: str, statement: Executable, values: Values | None = None) -> Row[Any]:
        row = self._read(statement, values).one_or_none()
        if row is None:
            raise NotFoundError(kind, id_)
        return row

    def _newest_first(
        self,
        statement: Select[Any],
        column: Column[str],
        record: Callable[[Row[Any]], T],
        *,
        cursor: str | None,
        limit: int,
    ) -> Page[T]:
        """Page of a list by id, newest first."""
        if cursor is not None:
            statement = statement.where(column < cursor)
        rows = self._read(statement.order_by(column.desc()).limit(limit + 1)).all()
        return page(rows, record, lambda row: str(row.id), limit=limit)


def page(
    rows: Sequence[Row[Any]], record: Callable[[Row[Any]], T], cursor: Callable[[Row[Any]], str], *, limit: int
) -> Page[T]:
    """Page from up to ``limit + 1`` rows: the extra one only tells that there are more."""
    shown = rows[:limit]
    return Page(tuple(record(row) for row in shown), cursor(shown[-1]) if len(rows) > limit else None)


def expect_one(result: CursorResult[Any], kind: str, id_: str) -> None:
    """Raise NotFoundError unless a statement changed a row."""
    if result.rowcount == 0:
        raise NotFoundError(kind, id_)
