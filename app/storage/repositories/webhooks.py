"""Webhooks and the outbox of what is to be told to them."""

from __future__ import annotations

from collections.abc import Sequence
from collections.abc import Set as AbstractSet
from dataclasses import asdict
from datetime import datetime
from typing import Any

from sqlalchemy import Row, delete, func, insert, select, update

from app.services.records import Page
from app.services.webhook_records import Delivery, DeliveryState, Webhook, WebhookEvent
from app.storage.geofence_models import webhook_deliveries, webhooks
from app.storage.repositories.base import Repository, expect_one

_OLDEST = webhook_deliveries.alias("oldest")
# one step of an index a webhook, however many messages wait
_FIRST_PENDING = (
    select(func.min(_OLDEST.c.id))
    .where(_OLDEST.c.webhook_id == webhooks.c.id, _OLDEST.c.state == DeliveryState.PENDING.value)
    .scalar_subquery()
)


class SqlWebhookRepository(Repository):
    """Port ``WebhookRepository``."""

    def add(self, webhook: Webhook) -> None:
        """Store a webhook."""
        self._write(insert(webhooks).values(_columns(webhook)))

    def get(self, webhook_id: str) -> Webhook:
        """One webhook."""
        return _webhook(self._one("webhook", webhook_id, select(webhooks).where(webhooks.c.id == webhook_id)))

    def list(self, *, cursor: str | None, limit: int) -> Page[Webhook]:
        """Webhooks, newest first."""
        return self._newest_first(select(webhooks), webhooks.c.id, _webhook, cursor=cursor, limit=limit)

    def active(self) -> Sequence[Webhook]:
        """Webhooks that want to be told now."""
        return [_webhook(row) for row in self._read(select(webhooks).where(webhooks.c.active).order_by(webhooks.c.id))]

    def count(self) -> int:
        """How many there are."""
        return int(self._read(select(func.count()).select_from(webhooks)).scalar_one())

    def update(self, webhook: Webhook) -> None:
        """Store a webhook anew."""
        statement = update(webhooks).where(webhooks.c.id == webhook.id).values(_columns(webhook))
        expect_one(self._write(statement), "webhook", webhook.id)

    def delete(self, webhook_id: str) -> None:
        """Delete a webhook with all its deliveries."""
        self._write(delete(webhook_deliveries).where(webhook_deliveries.c.webhook_id == webhook_id))
        expect_one(self._write(delete(webhooks).where(webhooks.c.id == webhook_id)), "webhook", webhook_id)

    def add_deliveries(self, deliveries: Sequence[Delivery]) -> None:
        """Store messages to be sent."""
        self._write(insert(webhook_deliveries), [asdict(one) for one in deliveries])

    def get_delivery(self, delivery_id: str) -> Delivery:
        """One delivery."""
        statement = select(webhook_deliveries).where(webhook_deliveries.c.id == delivery_id)
        return _delivery(self._one("delivery", delivery_id, statement))

    def list_deliveries(
        self, webhook_id: str, *, state: DeliveryState | None, cursor: str | None, limit: int
    ) -> Page[Delivery]:
        """Deliveries of a webhook, newest first."""
        statement = select(webhook_deliveries).where(webhook_deliveries.c.webhook_id == webhook_id)
        if state is not None:
            statement = statement.where(webhook_deliveries.c.state == state)
        return self._newest_first(statement, webhook_deliveries.c.id, _delivery, cursor=cursor, limit=limit)

    def due(self, now: datetime, *, without: AbstractSet[str], limit: int) -> Sequence[tuple[Webhook, Delivery]]:
        """The oldest pending delivery of each active webhook, if its time has come, but of those ``without``."""
        waiting = (
            select(webhook_deliveries)
            .select_from(webhooks)
            .join(webhook_deliveries, webhook_deliveries.c.id == _FIRST_PENDING)
            .where(webhooks.c.active, webhooks.c.id.not_in(without), webhook_deliveries.c.next_attempt_at <= now)
            .order_by(webhook_deliveries.c.next_attempt_at)
            .limit(limit)
        )
        found = [_delivery(row) for row in self._read(waiting)]
        hooks = {one.webhook_id: self.get(one.webhook_id) for one in found}
        return [(hooks[one.webhook_id], one) for one in found]

    def oldest_pending(self, *, limit: int) -> Sequence[Delivery]:
        """The oldest pending delivery of each active webhook, due or not, the oldest first."""
        waiting = (
            select(webhook_deliveries)
            .select_from(webhooks)
            .join(webhook_deliveries, webhook_deliveries.c.id == _FIRST_PENDING)
            .where(webhooks.c.active)
            .order_by(webhook_deliveries.c.id)
            .limit(limit)
        )
        return tuple(_delivery(row) for row in self._read(waiting))

    def settle(self, delivery: Delivery) -> bool:
        """Store what came of an attempt; False if the delivery is not pending in the attempt before any more."""
        before = (webhook_deliveries.c.state == DeliveryState.PENDING) & (
            webhook_deliveries.c.attempts == delivery.attempts - 1
        )
        names = ("state", "attempts", "next_attempt_at", "last_attempt_at", "last_status", "last_error")
        statement = update(webhook_deliveries).where(webhook_deliveries.c.id == delivery.id, before)
        return self._write(statement.values({name: getattr(delivery, name) for name in names})).rowcount > 0

    def prune(self, before: datetime) -> int:
        """Forget deliveries made before this that are not pending."""
        old = (webhook_deliveries.c.created_at < before) & (webhook_deliveries.c.state != DeliveryState.PENDING)
        return self._write(delete(webhook_deliveries).where(old)).rowcount


def _columns(webhook: Webhook) -> dict[str, Any]:
    return asdict(webhook) | {"events": sorted(webhook.events)}


def _webhook(row: Row[Any]) -> Webhook:
    values = dict(row._mapping)
    return Webhook(**values | {"events": frozenset(map(WebhookEvent, values["events"]))})


def _delivery(row: Row[Any]) -> Delivery:
    values = dict(row._mapping)
    return Delivery(**values | {"event": WebhookEvent(values["event"]), "state": DeliveryState(values["state"])})
