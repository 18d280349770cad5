"""What the use cases of webhooks need from storage."""

from __future__ import annotations

from collections.abc import Sequence
from collections.abc import Set as AbstractSet
from datetime import datetime
from typing import Protocol

from app.services.records import Page
from app.services.webhook_records import Delivery, DeliveryState, Webhook


class WebhookRepository(Protocol):
    """Webhooks and what is to be told to them (the outbox)."""

    def add(self, webhook: Webhook) -> None:
        """Store a webhook."""
        ...

    def get(self, webhook_id: str) -> Webhook:
        """One webhook."""
        ...

    def list(self, *, cursor: str | None, limit: int) -> Page[Webhook]:
        """Webhooks, newest first."""
        ...

    def active(self) -> Sequence[Webhook]:
        """Webhooks that want to be told now."""
        ...

    def count(self) -> int:
        """How many there are."""
        ...

    def update(self, webhook: Webhook) -> None:
        """Store a webhook anew, in place of the one with its id."""
        ...

    def delete(self, webhook_id: str) -> None:
        """Delete a webhook with all its deliveries."""
        ...

    def add_deliveries(self, deliveries: Sequence[Delivery]) -> None:
        """Store messages to be sent."""
        ...

    def get_delivery(self, delivery_id: str) -> Delivery:
        """One delivery."""
        ...

    def list_deliveries(
        self, webhook_id: str, *, state: DeliveryState | None, cursor: str | None, limit: int
    ) -> Page[Delivery]:
        """Deliveries of a webhook, newest first."""
        ...

    def due(self, now: datetime, *, without: AbstractSet[str], limit: int) -> Sequence[tuple[Webhook, Delivery]]:
        """The oldest pending delivery of each active webhook, if its time has come, but of those ``without``."""
        ...

    def oldest_pending(self, *, limit: int) -> Sequence[Delivery]:
        """The oldest pending delivery of each active webhook, due or not, the oldest first."""
        ...

    def settle(self, delivery: Delivery) -> bool:
        """Store what came of an attempt; False if the delivery is not pending in the attempt before any more."""
        ...

    def prune(self, before: datetime) -> int:
        """Forget deliveries made before this that are not pending; returns how many."""
        ...
