"""API keys."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import Field

from app.api.schemas.base import In, Name, Out, PageOut, Time, example
from app.services import records
from app.services.records import Scope

_KEY = {
    "id": "key_019ab2c4d1e07f3a9b2c4d5e6f",
    "name": "phone app",
    "scopes": ["locate"],
    "created_at": "2026-11-22T09:30:00.000Z",
    "last_used_at": None,
    "revoked_at": None,
}


class KeyIn(In):
    """A key to create."""

    model_config = example({"name": "phone app", "scopes": ["locate"]})

    name: Name
    scopes: Annotated[list[Scope], Field(min_length=1, max_length=3, description="`admin` includes the others.")]


class KeyOut(Out):
    """A key without its secret."""

    model_config = example(_KEY)

    id: str
    name: str
    scopes: list[Scope]
    created_at: Time
    last_used_at: Annotated[Time | None, Field(description="To the minute.")]
    revoked_at: Time | None

    @classmethod
    def of(cls, key: records.ApiKey) -> Self:
        """Show a key."""
        return cls(
            id=key.id,
            name=key.name,
            scopes=sorted(key.scopes),
            created_at=key.created_at,
            last_used_at=key.last_used_at,
            revoked_at=key.revoked_at,
        )


class NewKeyOut(KeyOut):
    """A key just created: the only time its secret is told."""

    model_config = example({**_KEY, "secret": "isk_7f3a9b2c4d5e6f_x9Jm2vQ0c1p8Zt4yB6nKd3hL"})

    secret: str


class KeyPage(PageOut):
    """Keys, newest first, revoked ones too."""

    model_config = example({"items": [_KEY], "next_cursor": None})

    items: list[KeyOut]
