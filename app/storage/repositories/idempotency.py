"""Answers given to requests with an ``Idempotency-Key``."""

from __future__ import annotations

from datetime import datetime, timedelta

from sqlalchemy import delete, insert, select

from app.storage.models import idempotency_keys
from app.storage.repositories.base import Repository

_KEPT = timedelta(days=1)


class SqlIdempotencyRepository(Repository):
    """Port ``IdempotencyRepository``."""

    def find(self, key_id: str, idempotency_key: str) -> tuple[str, str] | None:
        """``(request hash, created id)`` of the first request with this key."""
        statement = select(idempotency_keys.c.request_hash, idempotency_keys.c.created_id).where(
            idempotency_keys.c.key_id == key_id, idempotency_keys.c.idempotency_key == idempotency_key
        )
        row = self._read(statement).one_or_none()
        return None if row is None else (row.request_hash, row.created_id)

    def add(self, key_id: str, idempotency_key: str, request_hash: str, created_id: str, now: datetime) -> None:
        """Note what a request created; forget what is older than a day."""
        self._write(delete(idempotency_keys).where(idempotency_keys.c.created_at < now - _KEPT))
        self._write(
            insert(idempotency_keys).values(
                key_id=key_id,
                idempotency_key=idempotency_key,
                request_hash=request_hash,
                created_id=created_id,
                created_at=now,
            )
        )
