"""What is told to webhooks besides crossings of geofences."""

from __future__ import annotations

from app.services.ids import new_id
from app.services.ports import UnitOfWork
from app.services.records import Publication, Session
from app.services.webhook_outbox import announce, iso
from app.services.webhook_records import WebhookEvent


def tell_published(uow: UnitOfWork, publication: Publication) -> None:
    """Another map version is its level's current one; to be called in that transaction."""
    venue_id = uow.levels.get(publication.level_id).venue_id
    data = {
        "publication_id": publication.id,
        "venue_id": venue_id,
        "level_id": publication.level_id,
        "map_id": publication.map_id,
        "from_map_id": publication.from_map_id,
        "note": publication.note,
        "created_at": iso(publication.created_at),
    }
    at, level_id = publication.created_at, publication.level_id
    announce(uow, WebhookEvent.MAP_PUBLISHED, new_id("evt", at), data, at, venue_id=venue_id, level_id=level_id)


def tell_closed(uow: UnitOfWork, session: Session) -> None:
    """A session takes no more segments; to be called in the transaction that closes it."""
    at = session.closed_at
    if at is None:
        return
    data = {
        "session_id": session.id,
        "device_id": session.device_id,
        "venue_id": session.venue_id,
        "level_id": session.level_id,
        "method": session.method,
        "n_segments": session.next_seq,
        "created_at": iso(session.created_at),
        "closed_at": iso(at),
    }
    announce(
        uow,
        WebhookEvent.SESSION_CLOSED,
        new_id("evt", at),
        data,
        at,
        venue_id=session.venue_id,
        level_id=session.level_id,
    )
