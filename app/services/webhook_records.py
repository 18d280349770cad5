"""Records of webhooks: addresses that want to be told, and what is to be told to them."""

from __future__ import annotations

from dataclasses import dataclass, field
from datetime import datetime
from enum import StrEnum


class WebhookEvent(StrEnum):
    """What may be told; ``test`` only when it is asked for."""

    GEOFENCE_ENTER = "geofence.enter"
    GEOFENCE_LEAVE = "geofence.leave"
    GEOFENCE_DWELL = "geofence.dwell"
    MAP_PUBLISHED = "map.published"
    SESSION_CLOSED = "session.closed"
    TEST = "test"


class DeliveryState(StrEnum):
    """Where a delivery stands; ``dead`` was given up."""

    PENDING = "pending"
    DELIVERED = "delivered"
    DEAD = "dead"


@dataclass(frozen=True, slots=True)
class Webhook:
    """An address that wants to be told.

    ``venue_id`` and ``level_id`` narrow what is told. The secret signs every message, so it is kept as it is; it
    leaves the service once, when the webhook is made.
    """

    id: str
    url: str
    events: frozenset[WebhookEvent]
    venue_id: str | None
    level_id: str | None
    active: bool
    secret: str = field(repr=False)
    created_at: datetime
    updated_at: datetime


@dataclass(frozen=True, slots=True)
class Delivery:
    """One message to one webhook.

    Attributes
    ----------
    event_id : str
        The same for all webhooks that are told, and for repetitions: receivers know by it what they have.
    body : str
        JSON, as it is sent and signed.
    attempts : int
    next_attempt_at : datetime or None
        While it is pending: not before this, and not before those that came before it.
    last_status : int or None
        HTTP status of the last answer; None if there was none, which ``last_error`` explains.
    """

    id: str
    webhook_id: str
    event_id: str
    event: WebhookEvent
    body: str
    state: DeliveryState
    attempts: int
    next_attempt_at: datetime | None
    last_attempt_at: datetime | None
    last_status: int | None
    last_error: str | None
    created_at: datetime


@dataclass(frozen=True, slots=True)
class Attempt:
    """What came of sending a message: the status answered, or why there was no answer."""

    status: int | None
    error: str | None = None

    @property
    def succeeded(self) -> bool:
        """Whether the receiver has the message."""
        return self.error is None and self.status is not None and 200 <= self.status < 300
