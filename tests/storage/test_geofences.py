"""Geofences, stays and the outbox as they are stored."""

from __future__ import annotations

from dataclasses import replace
from datetime import timedelta
from pathlib import Path
from typing import Any

import pytest
from alembic import command
from sqlalchemy import event, inspect

from app.services.geofence_records import EventFilter, Geofence, GeofenceEvent, GeofenceEventKind, Stay, Watched
from app.services.records import Level, Venue, VenueKind
from app.services.webhook_records import Delivery, DeliveryState, Webhook, WebhookEvent
from app.storage import Database
from app.storage.migrations import config_for, upgrade
from tests.support.builders import START, World

EVERYWHERE = (-1e6, -1e6, 1e6, 1e6)


def geofence(number: int, level_id: str, x: float = 0.0) -> Geofence:
    polygon = ((x, 0.0), (x + 2.0, 0.0), (x + 2.0, 2.0))
    events = frozenset({GeofenceEventKind.ENTER, GeofenceEventKind.DWELL})
    return Geofence(f"gfc_{number}", level_id, f"no. {number}", polygon, events, 30.0, 0.9, START, START)


def crossing(number: int, session_id: str, level_id: str, t: float = 5.0) -> GeofenceEvent:
    return GeofenceEvent(
        id=f"gev_{number}",
        kind=GeofenceEventKind.ENTER,
        geofence_id="gfc_1",
        geofence_name="no. 1",
        session_id=session_id,
        device_id=None,
        venue_id="ven",
        level_id=level_id,
        seq=number,
        t=t,
        x=1.5,
        y=None,
        probability=0.93,
        dwell_s=None,
        reason=None,
        created_at=START,
    )


@pytest.fixture
def levels(database: Database) -> tuple[str, str]:
    with database(write=True) as uow:
        uow.venues.add(Venue("ven", "House", VenueKind.INDOOR, None, START, START))
        for id_ in ("lvl_a", "lvl_b"):
            uow.levels.add(Level(id_, "ven", id_, 0, (0, 0, 90, 90), False, False, None, START, START))
    return "lvl_a", "lvl_b"


def test_geofences_come_back_as_they_were(database: Database, levels: tuple[str, str]) -> None:
    made = geofence(1, levels[0])
    with database(write=True) as uow:
        uow.geofences.add(made)
        uow.geofences.add(geofence(2, levels[1]))
    with database(write=True) as uow:
        assert uow.geofences.get("gfc_1") == made
        assert uow.geofences.count(levels[0]) == 1
        changed = replace(made, name="other", dwell_s=None, polygon=((5.0, 5.0), (6.0, 5.0), (6.0, 6.0)))
        uow.geofences.update(changed)
        assert uow.geofences.list(level_id=levels[0], cursor=None, limit=9).items == (changed,)
        assert [one.id for one in uow.geofences.list(level_id=None, cursor=None, limit=9).items] == ["gfc_2", "gfc_1"]


def test_a_session_watches_what_it_may_reach_and_where_it_is(world: World) -> None:
    level = world.mapped_level()
    other = world.services.venues.create_level(level.venue_id, "2", 1, level.extent)
    session_id, second = world.session(level.id).id, world.session(level.id).id
    near, far, above = geofence(1, level.id), geofence(2, level.id, 50.0), geofence(3, other.id)
    with world.database(write=True) as uow:
        for one in (near, far, above):
            uow.geofences.add(one)
        box = (1.0, -5.0, 1.5, 0.5)
        assert uow.geofences.watched(session_id, {level.id}, box) == [Watched(near, session_id, None)]
        assert uow.geofences.watched(session_id, {level.id}, (2.5, 0.0, 9.0, 9.0)) == []
        for one in (far, above):
            uow.geofences.set_stay(session_id, one.id, None, Stay(3.0))
        found = uow.geofences.watched(session_id, {level.id}, box)
        assert [(one.geofence.id, one.stay) for one in found] == [
            ("gfc_1", None),
            ("gfc_2", Stay(3.0)),
            ("gfc_3", Stay(3.0)),
        ]
        both = uow.geofences.watched(session_id, {level.id, other.id}, EVERYWHERE)
        assert [one.geofence.id for one in both] == ["gfc_1", "gfc_2", "gfc_3"]
        assert [one.geofence.id for one in uow.geofences.watched(second, {level.id}, box)] == ["gfc_1"]
        uow.geofences.set_stay(session_id, far.id, Stay(3.0), Stay(3.0, dwelled=True))
        assert uow.geofences.stays(geofence_id=far.id) == [Watched(far, session_id, Stay(3.0, dwelled=True))]
        uow.geofences.set_stay(session_id, far.id, Stay(3.0, dwelled=True), None)
        assert [one.geofence.id for one in uow.geofences.stays(session_id=session_id)] == [above.id]
        uow.geofences.delete(above.id)
        assert uow.geofences.stays(session_id=session_id) == []


def test_watching_searches_by_index(world: World) -> None:
    level = world.mapped_level()
    session_id = world.session(level.id).id
    sent: list[tuple[str, Any]] = []

    def executed(_c: object, _k: object, statement: str, parameters: object, *_rest: object) -> None:
        sent.append((statement, parameters))

    event.listen(world.database.engine, "before_cursor_execute", executed)
    with world.database() as uow:
        uow.geofences.watched(session_id, {level.id}, EVERYWHERE)
    event.remove(world.database.engine, "before_cursor_execute", executed)
    ((statement, parameters),) = [one for one in sent if one[0].startswith("SELECT")]
    with world.database.engine.connect() as connection:
        plan = connection.exec_driver_sql("EXPLAIN QUERY PLAN " + statement, parameters).fetchall()
    steps = [str(row[-1]) for row in plan]
    assert any("ix_geofences_level_id_id" in step for step in steps), steps
    assert not any(step.startswith("SCAN") for step in steps), steps


def test_events_are_listed_newest_first_and_by_page(world: World) -> None:
    level = world.mapped_level()
    session_id = world.session(level.id).id
    made = [crossing(i, session_id, level.id, t=float(i)) for i in range(5)]
    with world.database(write=True) as uow:
        uow.geofences.add_events(made)
        page = uow.geofences.list_events(EventFilter(session_id=session_id), cursor=None, limit=3)
        rest = uow.geofences.list_events(EventFilter(), cursor=page.next_cursor, limit=3)
        assert [*page.items, *rest.items] == made[::-1]
        assert rest.next_cursor is None
        assert uow.geofences.list_events(EventFilter(geofence_id="gfc_2"), cursor=None, limit=3).items == ()


def webhook(number: int, *, active: bool = True) -> Webhook:
    events = frozenset({WebhookEvent.GEOFENCE_ENTER, WebhookEvent.MAP_PUBLISHED})
    return Webhook(f"whk_{number}", "https://a.example/", events, None, "lvl", active, "whsec_x", START, START)


def delivery(number: int, hook: int = 1, **changes: object) -> Delivery:
    made = Delivery(
        id=f"whd_{number}",
        webhook_id=f"whk_{hook}",
        event_id=f"evt_{number}",
        event=WebhookEvent.GEOFENCE_ENTER,
        body='{"x":"ü"}',
        state=DeliveryState.PENDING,
        attempts=0,
        next_attempt_at=START,
        last_attempt_at=None,
        last_status=None,
        last_error=None,
        created_at=START,
    )
    return replace(made, **changes)


def test_webhooks_come_back_as_they_were_without_showing_their_secret(database: Database) -> None:
    hook = webhook(1)
    with database(write=True) as uow:
        uow.webhooks.add(hook)
        uow.webhooks.add(webhook(2, active=False))
        assert uow.webhooks.get("whk_1") == hook
        assert "whsec" not in repr(hook)
        assert [one.id for one in uow.webhooks.active()] == ["whk_1"]
        assert uow.webhooks.count() == 2
        uow.webhooks.update(replace(hook, active=False))
        assert uow.webhooks.active() == []


def test_the_oldest_message_of_each_webhook_is_due_and_holds_the_others_back(database: Database) -> None:
    later = START + timedelta(seconds=10)
    with database(write=True) as uow:
        for hook in (webhook(1), webhook(2), webhook(3, active=False)):
            uow.webhooks.add(hook)
        uow.webhooks.add_deliveries(
            [delivery(1), delivery(2), delivery(3, 2, next_attempt_at=later), delivery(4, 2), delivery(5, 3)]
        )

        def due(now: Any, *busy: str) -> list[str]:
            return [one.id for _, one in uow.webhooks.due(now, without=frozenset(busy), limit=9)]

        assert due(START) == ["whd_1"]
        assert due(later) == ["whd_1", "whd_3"]
        assert due(later, "whk_1") == ["whd_3"]
        assert due(START - timedelta(seconds=1)) == []
        done = replace(delivery(1), state=DeliveryState.DELIVERED, attempts=1, next_attempt_at=None, last_status=204)
        assert uow.webhooks.settle(done)
        assert not uow.webhooks.settle(done), "the answer of another attempt comes too late"
        assert due(START) == ["whd_2"]
        (stored,) = uow.webhooks.list_deliveries("whk_1", state=DeliveryState.DELIVERED, cursor=None, limit=9).items
        assert stored == done
        assert uow.webhooks.prune(later) == 1
        assert [one.id for one in uow.webhooks.list_deliveries("whk_1", state=None, cursor=None, limit=9).items] == [
            "whd_2"
        ]
        uow.webhooks.delete("whk_1")
        assert due(later) == ["whd_3"]


def test_the_migration_goes_there_and_back_and_keeps_the_rest(tmp_path: Path) -> None:
    database = Database.at(tmp_path / "old.db")
    with database.engine.begin() as connection:
        upgrade(connection, "r0015")
    with database(write=True) as uow:
        uow.venues.add(Venue("ven", "House", VenueKind.INDOOR, None, START, START))
        uow.levels.add(Level("lvl", "ven", "1", 0, (0, 0, 9, 9), False, False, None, START, START))
    new = {"geofences", "geofence_stays", "geofence_events", "webhooks", "webhook_deliveries"}
    assert not new & set(inspect(database.engine).get_table_names())
    for _ in range(2):
        database.migrate()
        with database(write=True) as uow:
            uow.geofences.add(geofence(1, "lvl"))
            uow.webhooks.add(webhook(1))
            uow.webhooks.add_deliveries([delivery(1)])
            assert uow.levels.get("lvl").name == "1"
        with database.engine.begin() as connection:
            command.downgrade(config_for(connection), "r0015")
        assert not new & set(inspect(database.engine).get_table_names())
    database.close()
