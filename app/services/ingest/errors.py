"""Errors of ingest.

::

    ServiceError
    └── IngestRefusedError    the message cannot be taken; the words are for the person with the phone
        └── UnknownTokenError
"""

from __future__ import annotations

from app.services.errors import ServiceError


class IngestRefusedError(ServiceError):
    """A message that is not taken, with the reason and what to do."""


class UnknownTokenError(IngestRefusedError):
    """No such token, or it was revoked."""

    def __init__(self) -> None:
        super().__init__("Isodyn does not know this address, or it was revoked: make a new one, and set it in the app")
