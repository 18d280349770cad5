"""The log of what was published on which level."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from sqlalchemy import Row, insert, select

from app.services.records import Page, Publication
from app.storage.models import publications
from app.storage.repositories.base import Repository


class SqlPublicationRepository(Repository):
    """Port ``PublicationRepository``."""

    def add(self, publication: Publication) -> None:
        """Log a publication."""
        self._write(insert(publications).values(asdict(publication)))

    def latest(self, level_id: str) -> Publication | None:
        """The last one of a level; None before the first."""
        items = self.list(level_id, cursor=None, limit=1).items
        return items[0] if items else None

    def list(self, level_id: str, *, cursor: str | None, limit: int) -> Page[Publication]:
        """Publications of a level, newest first."""
        statement = select(publications).where(publications.c.level_id == level_id)
        return self._newest_first(statement, publications.c.id, _publication, cursor=cursor, limit=limit)


def _publication(row: Row[Any]) -> Publication:
    return Publication(**row._mapping)
