"""Webhooks and their deliveries."""

from __future__ import annotations

import json
from typing import Annotated, Any, Literal, Self

from pydantic import Field

from app.api.schemas.base import IdRef, In, Out, PageOut, Time, example
from app.api.schemas.geofences import EVENT_EXAMPLE
from app.api.schemas.levels import LEVEL_ID
from app.services import webhook_records as records
from app.services.webhook_records import DeliveryState, WebhookEvent

WEBHOOK_ID = "whk_019ab2c4d1e07f3a9b2c4d5e6f"
_URL = "https://hooks.example.org/isodyn"
_NEW: dict[str, Any] = {"url": _URL, "events": ["geofence.enter", "geofence.leave"], "level_id": LEVEL_ID}
_WEBHOOK = {
    "id": WEBHOOK_ID,
    "venue_id": None,
    **_NEW,
    "active": True,
    "created_at": "2026-11-22T09:30:00.000Z",
    "updated_at": "2026-11-22T09:30:00.000Z",
}
_DELIVERY = {
    "id": "whd_019ab2c4d1e07f3a9b2c4d5e6f",
    "webhook_id": WEBHOOK_ID,
    "event_id": EVENT_EXAMPLE["id"],
    "event": "geofence.enter",
    "state": "pending",
    "attempts": 2,
    "next_attempt_at": "2026-11-22T09:30:08.000Z",
    "last_attempt_at": "2026-11-22T09:30:06.000Z",
    "last_status": 503,
    "last_error": "answered 503",
    "created_at": "2026-11-22T09:30:05.000Z",
    "message": {
        "id": EVENT_EXAMPLE["id"],
        "type": "geofence.enter",
        "created_at": "2026-11-22T09:30:05.000Z",
        "data": EVENT_EXAMPLE,
    },
}

Wanted = Literal[
    WebhookEvent.GEOFENCE_ENTER,
    WebhookEvent.GEOFENCE_LEAVE,
    WebhookEvent.GEOFENCE_DWELL,
    WebhookEvent.MAP_PUBLISHED,
    WebhookEvent.SESSION_CLOSED,
]
Url = Annotated[
    str,
    Field(
        min_length=1,
        max_length=2000,
        description="Where messages are posted to: https, and not inside the service's own network, unless the "
        "operator allows both (`ISODYN_WEBHOOK_PRIVATE_NETWORKS`).",
    ),
]
Events = Annotated[list[Wanted], Field(min_length=1, max_length=8, description="What is told.")]


class WebhookIn(In):
    """A webhook to create."""

    model_config = example(_NEW)

    url: Url
    events: Events
    venue_id: Annotated[IdRef | None, Field(description="Only what happens in this venue.")] = None
    level_id: Annotated[IdRef | None, Field(description="Only what happens on this level.")] = None
    active: bool = True


class WebhookPatch(In):
    """What to change; what is not sent stays as it is."""

    model_config = example({"active": False})

    url: Url | None = None
    events: Events | None = None
    active: bool | None = None


class WebhookOut(Out):
    """An address that wants to be told, without its secret."""

    model_config = example(_WEBHOOK)

    id: str
    url: str
    events: list[WebhookEvent]
    venue_id: str | None
    level_id: str | None
    active: Annotated[bool, Field(description="While it is not, nothing is told, and what waits is not sent.")]
    created_at: Time
    updated_at: Time

    @classmethod
    def of(cls, webhook: records.Webhook) -> Self:
        """Show a webhook."""
        return cls(
            id=webhook.id,
            url=webhook.url,
            events=[event for event in WebhookEvent if event in webhook.events],
            venue_id=webhook.venue_id,
            level_id=webhook.level_id,
            active=webhook.active,
            created_at=webhook.created_at,
            updated_at=webhook.updated_at,
        )


class NewWebhookOut(WebhookOut):
    """A webhook just created: the only time its secret is told."""

    model_config = example({**_WEBHOOK, "secret": "whsec_..."})

    secret: Annotated[str, Field(description="Signs every message. Keep it: it is not shown again.")]


class WebhookPage(PageOut):
    """Webhooks, newest first."""

    model_config = example({"items": [_WEBHOOK], "next_cursor": None})

    items: list[WebhookOut]


class DeliveryOut(Out):
    """One message to one webhook."""

    model_config = example(_DELIVERY)

    id: str
    webhook_id: str
    event_id: Annotated[str, Field(description="The same in every repetition: receivers know by it what they have.")]
    event: WebhookEvent
    state: Annotated[DeliveryState, Field(description="`dead`: given up; it can be sent again.")]
    attempts: int
    next_attempt_at: Annotated[Time | None, Field(description="Not before this, nor before those ahead of it.")]
    last_attempt_at: Time | None
    last_status: Annotated[int | None, Field(description="HTTP status of the last answer; null: there was none.")]
    last_error: str | None
    created_at: Time
    message: Annotated[dict[str, Any], Field(description="What is sent.")]

    @classmethod
    def of(cls, delivery: records.Delivery) -> Self:
        """Show a delivery."""
        return cls(
            id=delivery.id,
            webhook_id=delivery.webhook_id,
            event_id=delivery.event_id,
            event=delivery.event,
            state=delivery.state,
            attempts=delivery.attempts,
            next_attempt_at=delivery.next_attempt_at,
            last_attempt_at=delivery.last_attempt_at,
            last_status=delivery.last_status,
            last_error=delivery.last_error,
            created_at=delivery.created_at,
            message=json.loads(delivery.body),
        )


class DeliveryPage(PageOut):
    """Deliveries, newest first."""

    model_config = example({"items": [_DELIVERY], "next_cursor": None})

    items: list[DeliveryOut]
