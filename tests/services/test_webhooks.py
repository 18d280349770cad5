"""Webhooks: who is told what, and when a message is given up."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from datetime import timedelta

import pytest

from app.services.errors import ConflictError, InvalidError, NotFoundError
from app.services.geofences import GeofenceSpec
from app.services.geofencing import event_data
from app.services.records import Level
from app.services.webhook_addresses import check_url, is_public
from app.services.webhook_outbox import KEPT, OutboxService, RetryPolicy
from app.services.webhook_records import Attempt, Delivery, DeliveryState, Webhook, WebhookEvent
from app.services.webhooks import WebhookService
from tests.services.test_geofencing import IN, OUT, ROOM, Walker, room, told
from tests.support.builders import World

EVERYTHING = [event for event in WebhookEvent if event is not WebhookEvent.TEST]
URL = "https://hooks.example.org/isodyn?x=1"
OK, REFUSED, SILENT = Attempt(204), Attempt(500, "answered 500"), Attempt(None, "ConnectError: refused")


def hook(world: World, *events: WebhookEvent, **place: str | None) -> Webhook:
    return world.services.webhooks.create(URL, events or EVERYTHING, **place)  # type: ignore[arg-type]


def messages(world: World, webhook: Webhook) -> list[dict]:
    """What is to be told, oldest first."""
    return [json.loads(one.body) for one in reversed(world.services.webhooks.deliveries(webhook.id).items)]


def kinds(world: World, webhook: Webhook) -> list[str]:
    return [one["type"] for one in messages(world, webhook)]


def outbox(world: World, *, give_up_s: float = 3600.0, chance: Callable[[], float] = lambda: 0.5) -> OutboxService:
    policy = RetryPolicy(first_s=1.0, longest_s=8.0, give_up_s=give_up_s)
    return OutboxService(uow=world.database, clock=world.clock, policy=policy, chance=chance)


def with_message(world: World) -> tuple[Webhook, Delivery]:
    webhook = hook(world)
    return webhook, world.services.webhooks.test(webhook.id)


def test_a_message_says_what_the_event_says(world: World) -> None:
    level = world.mapped_level()
    webhook = hook(world, WebhookEvent.GEOFENCE_ENTER)
    room(world, level)
    Walker(world, level).at(IN)
    (event,) = told(world)
    (message,) = messages(world, webhook)
    assert (message["id"], message["type"], message["data"]) == (event.id, "geofence.enter", event_data(event))
    assert message["data"]["x"] == IN[0]
    ((_, delivery),) = world.services.outbox.due(limit=9)
    assert (delivery.event_id, delivery.webhook_id, delivery.state) == (event.id, webhook.id, DeliveryState.PENDING)


def test_each_webhook_is_told_what_it_wants(world: World) -> None:
    level = world.mapped_level()
    other = world.mapped_level()
    every = hook(world)
    leaves = hook(world, WebhookEvent.GEOFENCE_LEAVE, WebhookEvent.GEOFENCE_DWELL)
    elsewhere, there = hook(world, level_id=other.id), hook(world, venue_id=level.venue_id, level_id=level.id)
    silent = hook(world)
    world.services.webhooks.update(silent.id, active=False)
    room(world, level)
    walker = Walker(world, level)
    walker.at(IN)
    walker.at(IN, IN)
    walker.at(IN, OUT)
    walker.close()
    whole = ["geofence.enter", "geofence.dwell", "geofence.leave", "session.closed"]
    assert kinds(world, every) == kinds(world, there) == whole
    assert kinds(world, leaves) == ["geofence.dwell", "geofence.leave"]
    assert kinds(world, elsewhere) == kinds(world, silent) == []


def test_closing_again_is_not_told_again(world: World) -> None:
    level = world.mapped_level()
    webhook = hook(world)
    session = world.session(level.id)
    for _ in range(2):
        world.services.sessions.close(session.id)
    (message,) = messages(world, webhook)
    assert message["data"]["session_id"] == session.id
    assert message["data"]["closed_at"].endswith("Z")


def test_a_published_map_is_told_once(world: World) -> None:
    webhook = hook(world, WebhookEvent.MAP_PUBLISHED)
    level = world.mapped_level()
    map_id = world.services.venues.get_level(level.id).current_map_id
    assert map_id is not None
    world.services.versions.publish(level.id, map_id)
    (message,) = messages(world, webhook)
    assert (message["data"]["map_id"], message["data"]["from_map_id"]) == (map_id, None)
    assert (message["data"]["level_id"], message["data"]["venue_id"]) == (level.id, level.venue_id)


def test_messages_go_out_in_order_and_the_failing_one_first(world: World) -> None:
    webhook, first = with_message(world)
    second = world.services.webhooks.test(webhook.id)
    queue = outbox(world)
    ((_, due),) = queue.due(limit=9)
    assert due == first
    assert queue.due(without={webhook.id}, limit=9) == []
    failed = queue.settle(due, REFUSED)
    assert (failed.state, failed.attempts, failed.last_status, failed.last_error) == (
        DeliveryState.PENDING,
        1,
        500,
        "answered 500",
    )
    assert queue.due(limit=9) == [], "the second waits behind the first"
    world.clock.now += timedelta(seconds=1)
    ((_, due),) = queue.due(limit=9)
    assert queue.settle(due, OK).state is DeliveryState.DELIVERED
    ((_, due),) = queue.due(limit=9)
    assert due == second


def test_pauses_double_up_to_the_longest_and_spread(world: World) -> None:
    policy = RetryPolicy(first_s=1.0, longest_s=8.0)
    assert [policy.pause_s(n, 0.5) for n in (1, 2, 3, 4, 5, 99)] == [1.0, 2.0, 4.0, 8.0, 8.0, 8.0]
    assert (policy.pause_s(3, 0.0), policy.pause_s(3, 1.0)) == (2.0, 6.0)
    _, delivery = with_message(world)
    settled = outbox(world, chance=lambda: 0.0).settle(delivery, SILENT)
    assert settled.next_attempt_at is not None
    assert settled.last_attempt_at is not None
    assert settled.next_attempt_at - settled.last_attempt_at == timedelta(seconds=0.5)


def test_after_so_long_a_message_is_given_up_and_the_next_has_its_turn(world: World) -> None:
    webhook, first = with_message(world)
    world.clock.now += timedelta(seconds=50)
    second = world.services.webhooks.test(webhook.id)
    queue = outbox(world, give_up_s=60.0)
    tried = queue.settle(first, SILENT)
    assert tried.state is DeliveryState.PENDING
    world.clock.now += timedelta(seconds=20)
    dead = queue.settle(tried, SILENT)
    assert (dead.state, dead.attempts, dead.next_attempt_at, dead.last_error) == (
        DeliveryState.DEAD,
        2,
        None,
        SILENT.error,
    )
    assert world.services.webhooks.deliveries(webhook.id, DeliveryState.DEAD).items == (dead,)
    assert [one for _, one in queue.due(limit=9)] == [second]


def test_what_is_dead_or_delivered_can_be_sent_again(world: World) -> None:
    webhook, first = with_message(world)
    with pytest.raises(ConflictError, match="pending"):
        world.services.webhooks.redeliver(webhook.id, first.id)
    outbox(world, give_up_s=0.0).settle(first, SILENT)
    again = world.services.webhooks.redeliver(webhook.id, first.id)
    assert (again.event_id, again.body, again.attempts) == (first.event_id, first.body, 0)
    assert again.id != first.id
    assert [one for _, one in world.services.outbox.due(limit=9)] == [again]
    with pytest.raises(NotFoundError):
        world.services.webhooks.redeliver(hook(world).id, first.id)


def test_an_inactive_webhook_keeps_its_messages(world: World) -> None:
    webhook, delivery = with_message(world)
    world.services.webhooks.update(webhook.id, active=False)
    assert world.services.outbox.due(limit=9) == []
    for call in (
        lambda: world.services.webhooks.test(webhook.id),
        lambda: world.services.webhooks.redeliver(webhook.id, delivery.id),
    ):
        with pytest.raises(ConflictError, match="active"):
            call()
    world.services.webhooks.update(webhook.id, active=True, url="https://b.example/")
    ((found, due),) = world.services.outbox.due(limit=9)
    assert (found.url, due.id) == ("https://b.example/", delivery.id)


def test_a_deleted_webhook_gets_nothing_more(world: World) -> None:
    webhook, delivery = with_message(world)
    world.services.webhooks.delete(webhook.id)
    assert world.services.outbox.due(limit=9) == []
    world.services.outbox.settle(delivery, OK)  # was on its way
    with pytest.raises(NotFoundError):
        world.services.webhooks.deliveries(webhook.id)


def test_old_deliveries_are_forgotten_but_none_that_waits(world: World) -> None:
    webhook, first = with_message(world)
    second = world.services.webhooks.test(webhook.id)
    outbox(world).settle(first, OK)
    assert world.services.outbox.prune() == 0
    world.clock.now += KEPT + timedelta(seconds=1)
    assert world.services.outbox.prune() == 1
    assert [one.id for one in world.services.webhooks.deliveries(webhook.id).items] == [second.id]


def test_a_message_that_waits_for_long_is_an_alarm_until_it_is_sent(world: World) -> None:
    webhook, first = with_message(world)
    assert world.services.alarms.now() == ()
    tried = outbox(world).settle(first, REFUSED)
    world.clock.now += timedelta(minutes=16)
    (alarm,) = world.services.alarms.now()
    assert (alarm.rule, alarm.subject) == ("webhook-failing", webhook.id)
    assert "answered 500" in alarm.message
    outbox(world).settle(tried, OK)
    assert world.services.alarms.now() == ()


def test_secrets_are_long_and_differ(world: World) -> None:
    one, two = hook(world), hook(world)
    assert one.secret != two.secret
    assert one.secret.startswith("whsec_")
    assert len(one.secret) >= 48


def test_places_are_checked(world: World) -> None:
    level: Level = world.level()
    elsewhere = world.level()
    for place in ({"venue_id": "ven_0"}, {"level_id": "lvl_0"}):
        with pytest.raises(NotFoundError):
            hook(world, **place)
    with pytest.raises(InvalidError) as caught:
        hook(world, venue_id=elsewhere.venue_id, level_id=level.id)
    assert caught.value.field == "level_id"


@pytest.mark.parametrize("events", [[], [WebhookEvent.TEST]])
def test_a_webhook_wants_something(world: World, events: list[WebhookEvent]) -> None:
    with pytest.raises(InvalidError) as caught:
        world.services.webhooks.create(URL, events)
    assert caught.value.field == "events"


def test_there_are_so_many_webhooks(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("app.services.webhooks.MAX_WEBHOOKS", 1)
    hook(world)
    with pytest.raises(ConflictError, match="delete one"):
        hook(world)


@pytest.mark.parametrize(
    "url",
    [
        "http://hooks.example.org/",
        "https://localhost/",
        "https://api.localhost:8443/x",
        "https://127.0.0.1/",
        "https://10.1.2.3/",
        "https://172.16.0.1/",
        "https://192.168.1.4/",
        "https://169.254.169.254/latest/meta-data",
        "https://100.64.0.1/",
        "https://0.0.0.0/",
        "https://224.0.0.1/",
        "https://[::1]/",
        "https://[fe80::1]/",
        "https://[fd00::1]/",
        "https://[fec0::1]/",
        "https://[64:ff9b:1::7f00:1]/",
        "https://[::ffff:127.0.0.1]/",
        "https://[64:ff9b::7f00:1]/",
        "https://[2002:7f00:1::]/",
        "https://[::7f00:1]/",
    ],
)
def test_the_own_network_is_off_limits_unless_allowed(url: str) -> None:
    with pytest.raises(InvalidError) as caught:
        check_url(url, private_networks=False)
    assert caught.value.field == "url"
    assert "ISODYN_WEBHOOK_PRIVATE_NETWORKS" in caught.value.remedy
    assert check_url(url, private_networks=True) == url


@pytest.mark.parametrize(
    "url",
    [
        "",
        "hooks.example.org",
        "ftp://hooks.example.org/",
        "https:///x",
        "https://user:secret@hooks.example.org/",
        "https://hooks.example.org:99999/",
        "https://[::1/",
        "https://hooks.example.org/a b",
        "https://hooks.example.org/ü",
        "https://hooks.example.org/" + "a" * 2000,
    ],
)
@pytest.mark.parametrize("private", [True, False])
def test_what_is_no_address_is_refused(url: str, private: bool) -> None:
    with pytest.raises(InvalidError) as caught:
        check_url(url, private_networks=private)
    assert caught.value.field == "url"


@pytest.mark.parametrize("address", ["8.8.8.8", "2001:4860:4860::8888"])
def test_public_addresses_are_public(address: str) -> None:
    assert is_public(address)
    assert not is_public("fe80::1%eth0")


def test_private_networks_are_a_choice_of_the_operator(world: World) -> None:
    lenient = WebhookService(uow=world.database, clock=world.clock, private_networks=True)
    made = lenient.create("http://127.0.0.1:9/", EVERYTHING)
    with pytest.raises(InvalidError):
        world.services.webhooks.update(made.id, url="http://127.0.0.1:9/")
    assert replace(lenient.get(made.id)) == made


def test_spec_defaults_tell_enter_and_leave() -> None:
    assert {event.value for event in GeofenceSpec("x", ROOM).events} == {"enter", "leave"}
