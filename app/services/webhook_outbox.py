"""The outbox: what is to be told is stored in the transaction in which it happened, and sent from there.

So nothing is told that did not happen, and what happened is told at least once, whatever is killed. Messages to one
webhook go out one after the other, oldest first: while one cannot be delivered, those behind it wait.
"""

from __future__ import annotations

import json
import random
from collections.abc import Callable, Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, replace
from datetime import datetime, timedelta

from app.services.base import Service
from app.services.clock import Clock
from app.services.ids import new_id
from app.services.ports import UnitOfWork, UnitOfWorkFactory
from app.services.webhook_records import Attempt, Delivery, DeliveryState, Webhook, WebhookEvent

KEPT = timedelta(days=30)
"""How long deliveries that are settled can be looked at."""
_MAX_ERROR = 300


@dataclass(frozen=True, slots=True)
class RetryPolicy:
    """Pauses double from the first to the longest, each half again longer or shorter by chance, until time is up."""

    first_s: float = 1.0
    longest_s: float = 1800.0
    give_up_s: float = 86_400.0

    def pause_s(self, attempts: int, chance: float) -> float:
        """Pause after this many attempts; ``chance`` is 0 to 1."""
        return min(self.first_s * 2.0 ** min(attempts - 1, 30), self.longest_s) * (0.5 + chance)


def announce(
    uow: UnitOfWork,
    event: WebhookEvent,
    event_id: str,
    data: Mapping[str, object],
    now: datetime,
    *,
    venue_id: str,
    level_id: str | None,
) -> None:
    """Store what is to be told, for every webhook that wants it; to be called in the transaction where it happens."""
    told = [hook for hook in uow.webhooks.active() if _wants(hook, event, venue_id, level_id)]
    if told:
        body = message(event, event_id, data, now)
        uow.webhooks.add_deliveries([new_delivery(hook.id, event, event_id, body, now) for hook in told])


def message(event: WebhookEvent, event_id: str, data: Mapping[str, object], now: datetime) -> str:
    """A message as it is sent."""
    envelope = {"id": event_id, "type": event.value, "created_at": iso(now), "data": data}
    return json.dumps(envelope, separators=(",", ":"), ensure_ascii=False, allow_nan=False)


def iso(value: datetime) -> str:
    """A time as the API writes it."""
    return value.isoformat(timespec="milliseconds").replace("+00:00", "Z")


def new_delivery(webhook_id: str, event: WebhookEvent, event_id: str, body: str, now: datetime) -> Delivery:
    """A message that waits to be sent, at once."""
    return Delivery(
        id=new_id("whd", now),
        webhook_id=webhook_id,
        event_id=event_id,
        event=event,
        body=body,
        state=DeliveryState.PENDING,
        attempts=0,
        next_attempt_at=now,
        last_attempt_at=None,
        last_status=None,
        last_error=None,
        created_at=now,
    )


def _wants(hook: Webhook, event: WebhookEvent, venue_id: str, level_id: str | None) -> bool:
    return (
        event in hook.events
        and (hook.venue_id is None or hook.venue_id == venue_id)
        and (hook.level_id is None or hook.level_id == level_id)
    )


class OutboxService(Service):
    """What the dispatcher needs: messages whose time has come, and a place for what came of them."""

    def __init__(
        self,
        *,
        uow: UnitOfWorkFactory,
        clock: Clock,
        policy: RetryPolicy | None = None,
        chance: Callable[[], float] = random.random,
    ) -> None:
        super().__init__(uow=uow, clock=clock)
        self._policy = policy or RetryPolicy()
        self._chance = chance

    def due(self, *, without: AbstractSet[str] = frozenset(), limit: int) -> Sequence[tuple[Webhook, Delivery]]:
        """At most one message a webhook, but for webhooks ``without``: those to which one is on its way."""
        with self._uow() as uow:
            return uow.webhooks.due(self._clock(), without=without, limit=limit)

    def settle(self, delivery: Delivery, attempt: Attempt) -> Delivery:
        """Store what came of an attempt: delivered, tried again later, or given up after so many seconds."""
        now = self._clock()
        tried = replace(
            delivery,
            attempts=delivery.attempts + 1,
            next_attempt_at=None,
            last_attempt_at=now,
            last_status=attempt.status,
            last_error=attempt.error and attempt.error[:_MAX_ERROR],
        )
        settled = self._judged(tried, attempt, now)
        with self._uow(write=True) as uow:
            uow.webhooks.settle(settled)
        return settled

    def prune(self) -> int:
        """Forget deliveries that were settled and are older than :data:`KEPT`; returns how many."""
        with self._uow(write=True) as uow:
            return uow.webhooks.prune(self._clock() - KEPT)

    def _judged(self, tried: Delivery, attempt: Attempt, now: datetime) -> Delivery:
        if attempt.succeeded:
            return replace(tried, state=DeliveryState.DELIVERED)
        if now - tried.created_at >= timedelta(seconds=self._policy.give_up_s):
            return replace(tried, state=DeliveryState.DEAD)
        pause = timedelta(seconds=self._policy.pause_s(tried.attempts, self._chance()))
        return replace(tried, next_attempt_at=now + pause)
