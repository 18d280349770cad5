"""Publishing: making a map version the one that new sessions on its level use, and writing down that it was."""

from __future__ import annotations

from datetime import datetime

from app.services.ids import new_id
from app.services.ports import UnitOfWork
from app.services.records import MapInfo, Publication
from app.services.webhook_news import tell_published

BUILT = "built"
UPDATED = "updated"
IMPORTED = "imported"
"""Notes of versions that their build, update or import published."""


def publish(uow: UnitOfWork, info: MapInfo, now: datetime, *, key_id: str | None = None, note: str = "") -> Publication:
    """Make a stored map its level's current one; all ways to do so lead through here, so that the log is whole.

    A map that is current already stays so, and the publication that made it so is returned.
    """
    before = uow.levels.set_current_map(info.level_id, info.id, now)
    if before == info.id:
        last = uow.publications.latest(info.level_id)
        if last is not None and last.map_id == info.id:
            return last
    publication = Publication(
        id=new_id("pub", now),
        level_id=info.level_id,
        map_id=info.id,
        from_map_id=before,
        key_id=key_id,
        note=note,
        created_at=now,
    )
    uow.publications.add(publication)
    tell_published(uow, publication)
    return publication
