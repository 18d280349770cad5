"""Webhooks: who wants to be told, and what became of the messages."""

from __future__ import annotations

import secrets
from collections.abc import Iterable
from dataclasses import replace

from app.services.base import DEFAULT_LIMIT, Service, check_limit
from app.services.clock import Clock
from app.services.errors import ConflictError, InvalidError, NotFoundError
from app.services.ids import new_id
from app.services.ports import UnitOfWork, UnitOfWorkFactory
from app.services.records import Page
from app.services.webhook_addresses import check_url
from app.services.webhook_outbox import message, new_delivery
from app.services.webhook_records import Delivery, DeliveryState, Webhook, WebhookEvent

MAX_WEBHOOKS = 100


class WebhookService(Service):
    """Create, change and delete webhooks; look at deliveries and send some again."""

    def __init__(self, *, uow: UnitOfWorkFactory, clock: Clock, private_networks: bool = False) -> None:
        super().__init__(uow=uow, clock=clock)
        self._private_networks = private_networks

    def create(
        self,
        url: str,
        events: Iterable[WebhookEvent],
        *,
        venue_id: str | None = None,
        level_id: str | None = None,
        active: bool = True,
    ) -> Webhook:
        """Create a webhook, with a secret of 256 random bits that signs its messages."""
        now = self._clock()
        webhook = Webhook(
            id=new_id("whk", now),
            url=check_url(url, private_networks=self._private_networks),
            events=_wanted(events),
            venue_id=venue_id,
            level_id=level_id,
            active=active,
            secret=f"whsec_{secrets.token_urlsafe(32)}",
            created_at=now,
            updated_at=now,
        )
        with self._uow(write=True) as uow:
            _check_place(uow, webhook)
            if uow.webhooks.count() >= MAX_WEBHOOKS:
                raise ConflictError(f"there are {MAX_WEBHOOKS} webhooks already; delete one first")
            uow.webhooks.add(webhook)
        return webhook

    def get(self, webhook_id: str) -> Webhook:
        """One webhook."""
        with self._uow() as uow:
            return uow.webhooks.get(webhook_id)

    def list(self, cursor: str | None = None, limit: int = DEFAULT_LIMIT) -> Page[Webhook]:
        """Webhooks, newest first."""
        with self._uow() as uow:
            return uow.webhooks.list(cursor=cursor, limit=check_limit(limit))

    def update(
        self,
        webhook_id: str,
        *,
        url: str | None = None,
        events: Iterable[WebhookEvent] | None = None,
        active: bool | None = None,
    ) -> Webhook:
        """Change what is given. Messages that wait go to the new address; an inactive webhook's wait on."""
        with self._uow(write=True) as uow:
            known = uow.webhooks.get(webhook_id)
            changed = replace(
                known,
                url=known.url if url is None else check_url(url, private_networks=self._private_networks),
                events=known.events if events is None else _wanted(events),
                active=known.active if active is None else active,
                updated_at=self._clock(),
            )
            uow.webhooks.update(changed)
        return changed

    def delete(self, webhook_id: str) -> None:
        """Delete a webhook and its deliveries; what waits is not sent any more."""
        with self._uow(write=True) as uow:
            uow.webhooks.get(webhook_id)
            uow.webhooks.delete(webhook_id)

    def deliveries(
        self,
        webhook_id: str,
        state: DeliveryState | None = None,
        cursor: str | None = None,
        limit: int = DEFAULT_LIMIT,
    ) -> Page[Delivery]:
        """Deliveries of a webhook, newest first."""
        with self._uow() as uow:
            uow.webhooks.get(webhook_id)
            return uow.webhooks.list_deliveries(webhook_id, state=state, cursor=cursor, limit=check_limit(limit))

    def test(self, webhook_id: str) -> Delivery:
        """Queue a message of type ``test``, whatever the webhook wants else."""
        now = self._clock()
        with self._uow(write=True) as uow:
            webhook = _active(uow.webhooks.get(webhook_id))
            event_id = new_id("evt", now)
            body = message(WebhookEvent.TEST, event_id, {"webhook_id": webhook.id}, now)
            delivery = new_delivery(webhook.id, WebhookEvent.TEST, event_id, body, now)
            uow.webhooks.add_deliveries([delivery])
        return delivery

    def redeliver(self, webhook_id: str, delivery_id: str) -> Delivery:
        """Queue the message of a settled delivery once more, behind those that wait; its event keeps its id."""
        now = self._clock()
        with self._uow(write=True) as uow:
            webhook = _active(uow.webhooks.get(webhook_id))
            known = uow.webhooks.get_delivery(delivery_id)
            if known.webhook_id != webhook.id:
                raise NotFoundError("delivery", delivery_id)
            if known.state is DeliveryState.PENDING:
                raise ConflictError(f"delivery {delivery_id} is pending: it is sent without being asked")
            again = new_delivery(webhook.id, known.event, known.event_id, known.body, now)
            uow.webhooks.add_deliveries([again])
        return again


def _wanted(events: Iterable[WebhookEvent]) -> frozenset[WebhookEvent]:
    wanted = frozenset(events)
    if not wanted or WebhookEvent.TEST in wanted:
        names = ", ".join(event.value for event in WebhookEvent if event is not WebhookEvent.TEST)
        raise InvalidError("events", "names nothing that happens by itself", f"choose of: {names}")
    return wanted


def _check_place(uow: UnitOfWork, webhook: Webhook) -> None:
    """NotFoundError if venue or level are not there; InvalidError if the one is not in the other."""
    if webhook.venue_id is not None:
        uow.venues.get(webhook.venue_id)
    if webhook.level_id is not None:
        level = uow.levels.get(webhook.level_id)
        if webhook.venue_id not in (None, level.venue_id):
            raise InvalidError("level_id", f"is a level of venue {level.venue_id}", "name one place, or leave one out")


def _active(webhook: Webhook) -> Webhook:
    if not webhook.active:
        raise ConflictError(f"webhook {webhook.id} is not active; PATCH it with active: true first")
    return webhook
