"""``isodyn webhook``: addresses that are told what happens."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated

import typer

from app.cli.common import DEFAULT_URL, NAMED, Key, Url, connect, print_table, reported

app = typer.Typer(
    context_settings=NAMED, no_args_is_help=True, help="Have events posted to addresses; see what became of them."
)
WebhookId = Annotated[str, typer.Argument(help="Id of the webhook (whk_...).")]


class Event(StrEnum):
    """What may be told."""

    GEOFENCE_ENTER = "geofence.enter"
    GEOFENCE_LEAVE = "geofence.leave"
    GEOFENCE_DWELL = "geofence.dwell"
    MAP_PUBLISHED = "map.published"
    SESSION_CLOSED = "session.closed"


class State(StrEnum):
    """Where a delivery stands."""

    PENDING = "pending"
    DELIVERED = "delivered"
    DEAD = "dead"


@app.command("create")
@reported
def create(
    address: Annotated[str, typer.Argument(help="Where messages are posted to: an https URL.")],
    event: Annotated[list[Event], typer.Option(help="What is told. May be repeated.")],
    venue: Annotated[str | None, typer.Option(help="Only what happens in this venue.")] = None,
    level: Annotated[str | None, typer.Option(help="Only what happens on this level.")] = None,
    url: Url = DEFAULT_URL,
    key: Key = None,
) -> None:
    """Have events posted to an address; print the webhook's id, and the secret that signs its messages.

    The secret is shown only this once.

    Example:  isodyn webhook create https://hooks.example.org/isodyn --event geofence.enter --event geofence.leave
    """
    with connect(url, key) as client:
        made = client.create_webhook(address, [one.value for one in event], venue_id=venue, level_id=level)
    typer.echo(made.id)
    typer.echo(made.secret)


@app.command("list")
@reported
def list_webhooks(url: Url = DEFAULT_URL, key: Key = None) -> None:
    """List webhooks without their secrets, newest first.

    Example:  isodyn webhook list
    """
    with connect(url, key) as client:
        rows = [
            (
                one.id,
                one.url,
                " ".join(one.events),
                " ".join(place for place in (one.venue_id, one.level_id) if place) or "everywhere",
                "" if one.active else "not active",
            )
            for one in client.webhooks()
        ]
    print_table(("webhook", "address", "is told", "where", ""), rows, empty="no webhooks yet")


@app.command("test")
@reported
def try_out(webhook_id: WebhookId, url: Url = DEFAULT_URL, key: Key = None) -> None:
    """Send a test message; `isodyn webhook deliveries` tells what came of it.

    Example:  isodyn webhook test whk_...
    """
    with connect(url, key) as client:
        typer.echo(client.test_webhook(webhook_id).id)


@app.command("deliveries")
@reported
def deliveries(
    webhook_id: WebhookId,
    state: Annotated[State | None, typer.Option(help="Only in this state.")] = None,
    limit: Annotated[int, typer.Option(min=1, help="How many at most.")] = 50,
    again: Annotated[str | None, typer.Option(help="Send this delivery (whd_...) once more first.")] = None,
    url: Url = DEFAULT_URL,
    key: Key = None,
) -> None:
    """List what was told, waits to be told, or was given up, newest first.

    Example:  isodyn webhook deliveries whk_... --state dead
    Example:  isodyn webhook deliveries whk_... --again whd_...
    """
    from itertools import islice

    with connect(url, key) as client:
        if again is not None:
            client.redeliver(webhook_id, again)
        found = client.webhook_deliveries(webhook_id, state=state and state.value)
        rows = [
            (
                one.id,
                one.event,
                one.state.value,
                one.attempts,
                f"{one.created_at:%Y-%m-%d %H:%M:%S}",
                "" if one.next_attempt_at is None else f"{one.next_attempt_at:%H:%M:%S}",
                one.last_error or one.last_status or "",
            )
            for one in islice(found, limit)
        ]
    columns = ("delivery", "event", "state", "tries", "since (UTC)", "next", "last answer")
    print_table(columns, rows, empty="no deliveries")


@app.command("delete")
@reported
def delete(webhook_id: WebhookId, url: Url = DEFAULT_URL, key: Key = None) -> None:
    """Delete a webhook; what waits is not sent any more.

    Example:  isodyn webhook delete whk_...
    """
    with connect(url, key) as client:
        client.delete_webhook(webhook_id)
    typer.echo(f"{webhook_id} is deleted")
