"""API keys."""

from __future__ import annotations

from datetime import datetime
from typing import Any

from sqlalchemy import Row, bindparam, func, insert, select, update

from app.services.records import ApiKey, Page, Scope
from app.storage.models import api_keys
from app.storage.repositories.base import Repository

_FIND = select(api_keys).where(api_keys.c.secret_hash == bindparam("hash"))


class SqlKeyRepository(Repository):
    """Port ``KeyRepository``."""

    def add(self, key: ApiKey, secret_hash: str) -> None:
        """Store a key by the hash of its secret."""
        self._write(
            insert(api_keys).values(
                id=key.id,
                name=key.name,
                scopes=sorted(key.scopes),
                secret_hash=secret_hash,
                created_at=key.created_at,
                last_used_at=key.last_used_at,
                revoked_at=key.revoked_at,
            )
        )

    def find(self, secret_hash: str) -> ApiKey | None:
        """The key of this secret, revoked or not."""
        row = self._read(_FIND, {"hash": secret_hash}).one_or_none()
        return None if row is None else _key(row)

    def get(self, key_id: str) -> ApiKey:
        """One key."""
        return _key(self._one("key", key_id, select(api_keys).where(api_keys.c.id == key_id)))

    def list(self, *, cursor: str | None, limit: int) -> Page[ApiKey]:
        """Keys, newest first."""
        return self._newest_first(select(api_keys), api_keys.c.id, _key, cursor=cursor, limit=limit)

    def revoke(self, key_id: str, now: datetime) -> ApiKey:
        """Note the time of revocation, the first one if there are several."""
        self._write(
            update(api_keys).where(api_keys.c.id == key_id, api_keys.c.revoked_at.is_(None)).values(revoked_at=now)
        )
        return self.get(key_id)

    def touch(self, key_id: str, now: datetime) -> None:
        """Note that the key was used."""
        self._write(update(api_keys).where(api_keys.c.id == key_id).values(last_used_at=now))

    def count(self) -> int:
        """How many keys there are, revoked ones too."""
        return int(self._read(select(func.count()).select_from(api_keys)).scalar_one())


def _key(row: Row[Any]) -> ApiKey:
    scopes = frozenset(Scope(scope) for scope in row.scopes)
    return ApiKey(row.id, row.name, scopes, row.created_at, row.last_used_at, row.revoked_at)
