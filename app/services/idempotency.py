"""Repeated creating requests: an ``Idempotency-Key`` gives the first answer again."""

from __future__ import annotations

from app.services.base import Service
from app.services.errors import ConflictError


class IdempotencyService(Service):
    """Remembers for a day which thing a request with an idempotency key created."""

    def replay(self, key_id: str, idempotency_key: str, request_hash: str) -> str | None:
        """Id of what the first such request created; None if there was none.

        ConflictError if the key was used for another request.
        """
        with self._uow() as uow:
            known = uow.idempotency.find(key_id, idempotency_key)
        if known is None:
            return None
        first_hash, created_id = known
        if first_hash != request_hash:
            raise ConflictError("this Idempotency-Key was used for another request; use a new key for each request")
        return created_id

    def remember(self, key_id: str, idempotency_key: str, request_hash: str, created_id: str) -> None:
        """Note what a request created."""
        with self._uow(write=True) as uow:
            uow.idempotency.add(key_id, idempotency_key, request_hash, created_id, self._clock())
