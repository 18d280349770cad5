"""``Idempotency-Key`` on creating posts: the same request again gives the thing the first one made.

A key belongs to the caller's API key and is kept for a day. The answer shows the thing as it is now, with the
header ``Idempotency-Replayed: true``.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable
from threading import Lock
from typing import Annotated, Protocol, TypeVar

from fastapi import Depends, Request, Response

from app.api.auth import current_key
from app.api.errors import IdempotencyReuseError, RejectedError
from app.api.validation import FieldError
from app.services.errors import ConflictError, NotFoundError
from app.services.idempotency import IdempotencyService

HEADER = "Idempotency-Key"
_VALID = re.compile(r"[\x21-\x7e]{1,255}")
_STRIPES = 64


class HasId(Protocol):
    """A record with an id."""

    @property
    def id(self) -> str:
        """Id of the record."""
        ...


T = TypeVar("T", bound=HasId)


class Creations:
    """Creates things once per idempotency key.

    Creating and remembering are two transactions. Locks (striped by key) keep two requests of this process apart;
    after a crash between the two, a repetition creates the thing again: the promise is "at most once per answer".
    """

    def __init__(self, service: IdempotencyService) -> None:
        self._service = service
        self._locks = tuple(Lock() for _ in range(_STRIPES))

    def once(
        self, key_id: str, idempotency_key: str, request_hash: str, *, create: Callable[[], T], load: Callable[[str], T]
    ) -> tuple[T, bool]:
        """Create, or load what the first such request created; the flag says which (True: loaded)."""
        with self._locks[hash((key_id, idempotency_key)) % _STRIPES]:
            created_id = self._replay(key_id, idempotency_key, request_hash)
            if created_id is not None:
                try:
                    return load(created_id), True
                except NotFoundError as error:
                    raise IdempotencyReuseError(
                        f"what this {HEADER} created was deleted since ({created_id}); use a new one"
                    ) from error
            made = create()
            self._service.remember(key_id, idempotency_key, request_hash, made.id)
            return made, False

    def _replay(self, key_id: str, idempotency_key: str, request_hash: str) -> str | None:
        try:
            return self._service.replay(key_id, idempotency_key, request_hash)
        except ConflictError as error:
            raise IdempotencyReuseError(str(error)) from error


class Creation:
    """One creating request: ``once`` honours its idempotency key, if it has one."""

    def __init__(self, request: Request, response: Response) -> None:
        self._creations: Creations = request.app.state.context.creations
        self._key_id = current_key(request).id
        self._response = response
        self._idempotency_key = request.headers.get(HEADER)
        if self._idempotency_key is not None and not _VALID.fullmatch(self._idempotency_key):
            raise RejectedError(
                [FieldError(HEADER, "is not 1 to 255 visible ASCII characters", "send for instance a random UUID")]
            )
        body: bytes = getattr(request.state, "body", b"")
        self._hash = hashlib.sha256(f"{request.method} {request.url.path}\n".encode() + body).hexdigest()

    def once(self, create: Callable[[], T], load: Callable[[str], T]) -> T:
        """Create the thing, or load what the first request with this idempotency key created."""
        if self._idempotency_key is None:
            return create()
        made, replayed = self._creations.once(self._key_id, self._idempotency_key, self._hash, create=create, load=load)
        if replayed:
            self._response.headers["Idempotency-Replayed"] = "true"
        return made


async def _creation(request: Request, response: Response) -> Creation:
    return Creation(request, response)


CreationDep = Annotated[Creation, Depends(_creation)]

IDEMPOTENCY_PARAMETER = {
    "name": HEADER,
    "in": "header",
    "required": False,
    "description": "Makes the call repeatable: the same key and body within a day give the first thing created.",
    "schema": {"type": "string", "minLength": 1, "maxLength": 255},
    "example": "0d1f2a4c-6a5e-4f0e-9a43-1f6c3a7be9d2",
}
