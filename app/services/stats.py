"""Counts for operators."""

from __future__ import annotations

from app.services.base import Service
from app.services.records import Stats


class StatsService(Service):
    """Counts of everything stored."""

    def stats(self) -> Stats:
        """Counts as of now."""
        with self._uow() as uow:
            return uow.stats()
