"""Webhooks and their deliveries."""

from __future__ import annotations

from typing import Annotated

from fastapi import Query, Request, Response

from app.api import errors
from app.api.auth import needs
from app.api.deps import ServicesDep
from app.api.pagination import PagingDep, link_next
from app.api.responses import OBJECT, guarded
from app.api.routing import api_router
from app.api.schemas.webhooks import (
    DeliveryOut,
    DeliveryPage,
    NewWebhookOut,
    WebhookIn,
    WebhookOut,
    WebhookPage,
    WebhookPatch,
)
from app.services.records import Scope
from app.services.webhook_records import DeliveryState

router = api_router("webhooks")


@router.post(
    "/v1/webhooks",
    status_code=201,
    summary="Create a webhook",
    dependencies=[needs(Scope.ADMIN)],
    responses=guarded(*OBJECT, errors.NOT_FOUND, errors.CONFLICT),
)
def create_webhook(body: WebhookIn, services: ServicesDep, response: Response) -> NewWebhookOut:
    """Have events posted to an address. The secret that signs them is in this answer only."""
    webhook = services.webhooks.create(
        body.url, body.events, venue_id=body.venue_id, level_id=body.level_id, active=body.active
    )
    response.headers["Location"] = f"/v1/webhooks/{webhook.id}"
    response.headers["Cache-Control"] = "no-store"
    return NewWebhookOut(**WebhookOut.of(webhook).model_dump(), secret=webhook.secret)


@router.get(
    "/v1/webhooks", summary="List webhooks", dependencies=[needs(Scope.ADMIN)], responses=guarded(errors.INVALID)
)
def list_webhooks(services: ServicesDep, paging: PagingDep, request: Request, response: Response) -> WebhookPage:
    """Webhooks without their secrets, newest first."""
    page = services.webhooks.list(paging.cursor, paging.limit)
    link_next(request, response, page.next_cursor)
    return WebhookPage(items=[WebhookOut.of(one) for one in page.items], next_cursor=page.next_cursor)


@router.get(
    "/v1/webhooks/{webhook_id}",
    summary="Read a webhook",
    dependencies=[needs(Scope.ADMIN)],
    responses=guarded(errors.NOT_FOUND),
)
def get_webhook(webhook_id: str, services: ServicesDep) -> WebhookOut:
    """One webhook without its secret."""
    return WebhookOut.of(services.webhooks.get(webhook_id))


@router.patch(
    "/v1/webhooks/{webhook_id}",
    summary="Change a webhook",
    dependencies=[needs(Scope.ADMIN)],
    responses=guarded(*OBJECT, errors.NOT_FOUND),
)
def update_webhook(webhook_id: str, body: WebhookPatch, services: ServicesDep) -> WebhookOut:
    """Change address, events or whether it is active; what waits goes to the new address."""
    changed = services.webhooks.update(webhook_id, url=body.url, events=body.events, active=body.active)
    return WebhookOut.of(changed)


@router.delete(
    "/v1/webhooks/{webhook_id}",
    status_code=204,
    summary="Delete a webhook",
    dependencies=[needs(Scope.ADMIN)],
    responses=guarded(errors.NOT_FOUND),
)
def delete_webhook(webhook_id: str, services: ServicesDep) -> None:
    """Delete a webhook and its deliveries; what waits is not sent any more."""
    services.webhooks.delete(webhook_id)


@router.get(
    "/v1/webhooks/{webhook_id}/deliveries",
    summary="List deliveries of a webhook",
    dependencies=[needs(Scope.ADMIN)],
    responses=guarded(errors.NOT_FOUND, errors.INVALID),
)
def list_deliveries(
    webhook_id: str,
    services: ServicesDep,
    paging: PagingDep,
    request: Request,
    response: Response,
    state: Annotated[DeliveryState | None, Query(description="In this state only.")] = None,
) -> DeliveryPage:
    """What was told, waits to be told, or was given up, newest first; settled ones are kept for 30 days."""
    page = services.webhooks.deliveries(webhook_id, state, paging.cursor, paging.limit)
    link_next(request, response, page.next_cursor)
    return DeliveryPage(items=[DeliveryOut.of(one) for one in page.items], next_cursor=page.next_cursor)


@router.post(
    "/v1/webhooks/{webhook_id}/test",
    status_code=202,
    summary="Test a webhook",
    dependencies=[needs(Scope.ADMIN)],
    responses=guarded(errors.NOT_FOUND, errors.CONFLICT),
)
def test_webhook(webhook_id: str, services: ServicesDep) -> DeliveryOut:
    """Send a message of type `test`; its deliveries tell what came of it."""
    return DeliveryOut.of(services.webhooks.test(webhook_id))


@router.post(
    "/v1/webhooks/{webhook_id}/deliveries/{delivery_id}/redeliver",
    status_code=202,
    summary="Send a delivery again",
    dependencies=[needs(Scope.ADMIN)],
    responses=guarded(errors.NOT_FOUND, errors.CONFLICT),
)
def redeliver(webhook_id: str, delivery_id: str, services: ServicesDep) -> DeliveryOut:
    """Send the message of a delivery that is dead or delivered once more: a new delivery, with the same event id."""
    return DeliveryOut.of(services.webhooks.redeliver(webhook_id, delivery_id))
