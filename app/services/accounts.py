"""API keys: who may do what."""

from __future__ import annotations

import hashlib
import secrets
from collections.abc import Iterable
from datetime import datetime, timedelta

from app.services.base import DEFAULT_LIMIT, Service, check_limit
from app.services.ids import new_id
from app.services.records import ApiKey, Page, Scope

_TOUCH_EVERY = timedelta(minutes=1)


class AccountService(Service):
    """Create, verify and revoke keys. Secrets leave only once, when the key is made."""

    def create_key(self, name: str, scopes: Iterable[Scope]) -> tuple[ApiKey, str]:
        """Create a key and return it with its secret."""
        key, secret = _make_key(name, frozenset(scopes), self._clock())
        with self._uow(write=True) as uow:
            uow.keys.add(key, hash_secret(secret))
        return key, secret

    def verify(self, secret: str) -> ApiKey | None:
        """The key of this secret; None if there is none or it is revoked."""
        now = self._clock()
        with self._uow() as uow:
            key = uow.keys.find(hash_secret(secret))
        if key is None or key.revoked_at is not None:
            return None
        if key.last_used_at is None or now - key.last_used_at >= _TOUCH_EVERY:
            # not at every request: reading a key must not take the write lock each time
            with self._uow(write=True) as uow:
                uow.keys.touch(key.id, now)
        return key

    def list(self, cursor: str | None = None, limit: int = DEFAULT_LIMIT) -> Page[ApiKey]:
        """Keys, newest first, revoked ones too."""
        with self._uow() as uow:
            return uow.keys.list(cursor=cursor, limit=check_limit(limit))

    def get(self, key_id: str) -> ApiKey:
        """One key."""
        with self._uow() as uow:
            return uow.keys.get(key_id)

    def revoke(self, key_id: str) -> ApiKey:
        """Make a key useless at once; revoking again changes nothing."""
        with self._uow(write=True) as uow:
            return uow.keys.revoke(key_id, self._clock())

    def ensure_admin_key(self) -> str | None:
        """On the very first start: create an admin key and return its secret; None ever after."""
        key, secret = _make_key("first start", frozenset({Scope.ADMIN}), self._clock())
        with self._uow(write=True) as uow:
            if uow.keys.count():
                return None
            uow.keys.add(key, hash_secret(secret))
        return secret


def hash_secret(secret: str) -> str:
    """SHA-256 of a secret. Unsalted and fast is right here: secrets are 192 random bits, not passwords."""
    return hashlib.sha256(secret.encode()).hexdigest()


def _make_key(name: str, scopes: frozenset[Scope], now: datetime) -> tuple[ApiKey, str]:
    key_id = new_id("key", now)
    secret = f"isk_{key_id[-14:]}_{secrets.token_urlsafe(24)}"
    key = ApiKey(key_id, name, scopes, created_at=now, last_used_at=None, revoked_at=None)
    return key, secret
