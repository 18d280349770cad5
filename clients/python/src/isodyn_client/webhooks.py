"""Webhooks: models, the calls of the API, and the check that a received message is the service's."""

from __future__ import annotations

import hashlib
import hmac
import time
from collections.abc import Iterable, Mapping
from datetime import datetime
from enum import StrEnum
from typing import Any

from pydantic import ValidationError

from isodyn_client.calls import Call, Listing, as_model, nothing, present
from isodyn_client.encoding import json_body
from isodyn_client.errors import IsodynError
from isodyn_client.models import Model, Page

_PATH = "/v1/webhooks"
_PAGE = 100
TOLERANCE_S = 300.0
"""How old a message may be, and how far ahead the sender's clock."""


class InvalidSignatureError(IsodynError):
    """A received message is not the service's, was changed on its way, or is too old."""


class DeliveryState(StrEnum):
    """Where a delivery stands; ``dead`` was given up."""

    PENDING = "pending"
    DELIVERED = "delivered"
    DEAD = "dead"


class Webhook(Model):
    """An address that is told what happens, without its secret."""

    id: str
    url: str
    events: tuple[str, ...]
    venue_id: str | None = None
    level_id: str | None = None
    active: bool
    created_at: datetime
    updated_at: datetime


class NewWebhook(Webhook):
    """A webhook just created: the only time its secret is told."""

    secret: str


class WebhookMessage(Model):
    """A message as it is received. ``id`` is the same in repetitions; ``data`` depends on the ``type``."""

    id: str
    type: str
    created_at: datetime
    data: Mapping[str, Any]


class Delivery(Model):
    """One message to one webhook, and what came of it."""

    id: str
    webhook_id: str
    event_id: str
    event: str
    state: DeliveryState
    attempts: int
    next_attempt_at: datetime | None = None
    last_attempt_at: datetime | None = None
    last_status: int | None = None
    last_error: str | None = None
    created_at: datetime
    message: WebhookMessage


def create_webhook(
    url: str,
    events: Iterable[str],
    *,
    venue_id: str | None = None,
    level_id: str | None = None,
    active: bool | None = None,
) -> Call[NewWebhook]:
    """Have events posted to an address; the secret that signs them is told this once.

    ``events`` are of ``geofence.enter``, ``geofence.leave``, ``geofence.dwell``, ``map.published``, ``session.closed``.
    Not repeatable: nobody shows the secret again.
    """
    fields = {"url": url, "events": list(events), "venue_id": venue_id, "level_id": level_id, "active": active}
    return Call("POST", _PATH, as_model(NewWebhook), body=json_body(present(fields)), repeatable=False)


def webhook(webhook_id: str) -> Call[Webhook]:
    """One webhook without its secret."""
    return Call("GET", f"{_PATH}/{webhook_id}", as_model(Webhook))


def webhooks() -> Listing[Webhook]:
    """All webhooks without their secrets, newest first."""
    return Listing(Call("GET", _PATH, as_model(Page[Webhook]), params={"limit": _PAGE}))


def update_webhook(
    webhook_id: str, *, url: str | None = None, events: Iterable[str] | None = None, active: bool | None = None
) -> Call[Webhook]:
    """Change a webhook; what is None stays as it is."""
    fields = {"url": url, "events": None if events is None else list(events), "active": active}
    return Call("PATCH", f"{_PATH}/{webhook_id}", as_model(Webhook), body=json_body(present(fields)))


def delete_webhook(webhook_id: str) -> Call[None]:
    """Delete a webhook and its deliveries; what waits is not sent any more."""
    return Call("DELETE", f"{_PATH}/{webhook_id}", nothing)


def webhook_deliveries(webhook_id: str, *, state: DeliveryState | str | None = None) -> Listing[Delivery]:
    """Deliveries of a webhook (in one state), newest first."""
    params = present({"state": None if state is None else str(state), "limit": _PAGE})
    return Listing(Call("GET", f"{_PATH}/{webhook_id}/deliveries", as_model(Page[Delivery]), params=params))


def test_webhook(webhook_id: str) -> Call[Delivery]:
    """Send a message of type ``test``."""
    return Call("POST", f"{_PATH}/{webhook_id}/test", as_model(Delivery), repeatable=False)


def redeliver(webhook_id: str, delivery_id: str) -> Call[Delivery]:
    """Send the message of a delivery that is dead or delivered once more."""
    path = f"{_PATH}/{webhook_id}/deliveries/{delivery_id}/redeliver"
    return Call("POST", path, as_model(Delivery), repeatable=False)


def verify_webhook(
    secret: str, header: str, body: bytes, now: float | None = None, *, tolerance_s: float = TOLERANCE_S
) -> WebhookMessage:
    """Check a received message and read it.

    Parameters
    ----------
    secret : str
        What the webhook's creation told.
    header : str
        Value of ``Isodyn-Signature``.
    body : bytes
        As received: parsing and writing JSON anew changes it.
    now : float, optional
        Unix seconds; the clock's without it.
    tolerance_s : float
        Older messages are refused, so that nobody repeats one later.

    Raises
    ------
    InvalidSignatureError
        If the message is not to be believed.
    """
    t, signatures = _parts(header)
    expected = hmac.new(secret.encode(), f"{t}.".encode() + body, hashlib.sha256).hexdigest()
    if not any(hmac.compare_digest(expected.encode(), one.encode()) for one in signatures):
        raise InvalidSignatureError("the signature is not that of this body; is it the webhook's secret?")
    if abs((time.time() if now is None else now) - t) > tolerance_s:
        raise InvalidSignatureError(f"the message was signed more than {tolerance_s:g} s ago, or in the future")
    try:
        return WebhookMessage.model_validate_json(body)
    except ValidationError as error:
        raise InvalidSignatureError(f"the body is signed but no message: {error}") from error


def _parts(header: str) -> tuple[int, list[str]]:
    """Time and signatures; names that are not known are left to later versions."""
    pairs = [part.strip().partition("=")[::2] for part in header.split(",")]
    times = [value for name, value in pairs if name == "t"]
    if len(times) != 1 or not (times[0].isascii() and times[0].isdigit() and len(times[0]) <= 12):
        raise InvalidSignatureError("the header is not t=...,v1=...")
    return int(times[0]), [value for name, value in pairs if name == "v1"]
