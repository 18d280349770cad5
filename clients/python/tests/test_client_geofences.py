"""Geofences and webhooks: what is sent, what is read, and which messages are believed."""

from __future__ import annotations

import asyncio
import hashlib
import hmac
import json
from datetime import UTC, datetime
from typing import Any

import pytest
from conftest import NOW, FakeService, ok, problem
from isodyn_client import (
    Client,
    DeliveryState,
    GeofenceEventKind,
    InvalidSignatureError,
    IsodynError,
    OverloadedError,
    verify_webhook,
)

ROOM = ((10.0, 4.0), (16.0, 4.0), (16.0, 9.0))
GEOFENCE = {
    "id": "gfc_1",
    "name": "room",
    "level_id": "lvl_1",
    "polygon": [list(point) for point in ROOM],
    "events": ["enter"],
    "dwell_s": None,
    "confidence": 0.9,
    "created_at": NOW,
    "updated_at": NOW,
}
EVENT = {
    "id": "gev_1",
    "kind": "leave",
    "geofence_id": "gfc_1",
    "geofence_name": "room",
    "session_id": "ses_1",
    "venue_id": "ven_1",
    "level_id": "lvl_1",
    "t_ms": 1790000000000.0,
    "reason": "session closed",
    "created_at": NOW,
}
WEBHOOK = {
    "id": "whk_1",
    "url": "https://hooks.example.org/",
    "events": ["geofence.enter"],
    "active": True,
    "created_at": NOW,
    "updated_at": NOW,
}
MESSAGE = {"id": "gev_1", "type": "geofence.leave", "created_at": NOW, "data": EVENT}
DELIVERY = {
    "id": "whd_1",
    "webhook_id": "whk_1",
    "event_id": "gev_1",
    "event": "geofence.leave",
    "state": "dead",
    "attempts": 7,
    "last_status": 500,
    "created_at": NOW,
    "message": MESSAGE,
}
SECRET, T = "whsec_1", 1_790_000_000


def sent(service: FakeService, index: int = -1) -> tuple[str, str, Any]:
    request, body = service.requests[index], service.bodies[index]
    return request.method, str(request.url.raw_path, "ascii"), json.loads(body) if body else None


def test_geofences(service: FakeService, client: Client) -> None:
    service.will(ok(GEOFENCE, 201), ok(GEOFENCE), ok({"items": [GEOFENCE]}), ok(GEOFENCE), ok(None, 204))
    made = client.create_geofence("lvl_1", "room", ROOM, events=[GeofenceEventKind.ENTER])
    assert made.polygon == ROOM
    body = {"level_id": "lvl_1", "name": "room", "polygon": GEOFENCE["polygon"], "events": ["enter"]}
    assert sent(service) == ("POST", "/v1/geofences", body)
    assert "Idempotency-Key" in service.requests[0].headers
    assert client.geofence("gfc_1") == made
    assert list(client.geofences(level_id="lvl_1")) == [made]
    assert sent(service)[1] == "/v1/geofences?level_id=lvl_1&limit=100"
    client.update_geofence("gfc_1", dwell_s=5.0, events=["dwell"])
    assert sent(service) == ("PATCH", "/v1/geofences/gfc_1", {"events": ["dwell"], "dwell_s": 5.0})
    client.delete_geofence("gfc_1")
    assert sent(service) == ("DELETE", "/v1/geofences/gfc_1", None)


def test_events(service: FakeService, client: Client) -> None:
    service.will(ok({"items": [EVENT], "next_cursor": "gev_1"}), ok({"items": [EVENT]}), ok("a,b"))
    first, second = client.geofence_events(session_id="ses_1", kind="leave", after=datetime(2026, 11, 22, tzinfo=UTC))
    assert (first.kind, first.reason, first.x, first) == (GeofenceEventKind.LEAVE, "session closed", None, second)
    assert "after=2026-11-22T00%3A00%3A00%2B00%3A00" in sent(service, 0)[1]
    assert "cursor=gev_1" in sent(service, 1)[1]
    assert client.geofence_events_csv(level_id="lvl_1") == b'"a,b"'
    assert service.requests[-1].headers["Accept"] == "text/csv"


def test_webhooks(service: FakeService, client: Client) -> None:
    service.will(ok({**WEBHOOK, "secret": SECRET}, 201), ok(WEBHOOK), ok({"items": [WEBHOOK]}), ok(WEBHOOK))
    assert client.create_webhook(WEBHOOK["url"], ["geofence.enter"], level_id="lvl_1").secret == SECRET
    assert sent(service)[2] == {"url": WEBHOOK["url"], "events": ["geofence.enter"], "level_id": "lvl_1"}
    assert client.webhook("whk_1").events == ("geofence.enter",)
    assert [one.id for one in client.webhooks()] == ["whk_1"]
    client.update_webhook("whk_1", active=False)
    assert sent(service) == ("PATCH", "/v1/webhooks/whk_1", {"active": False})
    service.will(ok({"items": [DELIVERY]}), ok(DELIVERY, 202), ok(DELIVERY, 202), ok(None, 204))
    (delivery,) = client.webhook_deliveries("whk_1", state="dead")
    assert (delivery.state, delivery.last_status, delivery.message.data["id"]) == (DeliveryState.DEAD, 500, "gev_1")
    assert client.redeliver("whk_1", "whd_1") == client.test_webhook("whk_1")
    assert sent(service, -2)[1] == "/v1/webhooks/whk_1/deliveries/whd_1/redeliver"
    client.delete_webhook("whk_1")


def test_what_must_not_be_done_twice_is_not_repeated(service: FakeService) -> None:
    service.will(problem(503, "overloaded"), problem(500, "internal"))
    with service.client() as client, pytest.raises(IsodynError) as caught:
        client.create_webhook(WEBHOOK["url"], ["geofence.enter"])
    assert not isinstance(caught.value, OverloadedError)
    assert len(service.requests) == 2, "nothing was done when overloaded; who knows when it failed"


def test_the_async_client_has_them_too(service: FakeService) -> None:
    async def run() -> None:
        service.will(ok({"items": [EVENT]}), ok(WEBHOOK))
        async with service.async_client() as client:
            assert [event.id async for event in client.geofence_events()] == ["gev_1"]
            assert (await client.webhook("whk_1")).active

    asyncio.run(run())


def signed(body: bytes, *, secret: str = SECRET, t: int = T) -> str:
    return f"t={t},v1={hmac.new(secret.encode(), f'{t}.'.encode() + body, hashlib.sha256).hexdigest()}"


BODY = json.dumps(MESSAGE).encode()


def test_a_true_message_is_read() -> None:
    message = verify_webhook(SECRET, signed(BODY), BODY, now=T + 299.0)
    assert (message.id, message.type, message.data["kind"]) == ("gev_1", "geofence.leave", "leave")
    rotated = f"{signed(BODY, secret='old')},{signed(BODY).partition(',')[2]},v2=later"
    assert verify_webhook(SECRET, rotated, BODY, now=T) == message


@pytest.mark.parametrize(
    ("header", "body", "now"),
    [
        (signed(BODY, secret="whsec_2"), BODY, T),
        (signed(BODY), BODY + b" ", T),
        (signed(BODY).replace(str(T), str(T + 1)), BODY, T),
        (signed(BODY), BODY, T + 301),
        (signed(BODY), BODY, T - 301),
        ("", BODY, T),
        (f"t={T}", BODY, T),
        (f"t={T},v1=", BODY, T),
        (f"t={T},v1=ü", BODY, T),
        (signed(BODY).partition(",")[2], BODY, T),
        (f"t={T},{signed(BODY)}", BODY, T),
        (f"t=x{signed(BODY)[2:]}", BODY, T),
        (signed(b"{}"), b"{}", T),
        (signed(b"\xff"), b"\xff", T),
    ],
)
def test_other_messages_are_not_believed(header: str, body: bytes, now: float) -> None:
    with pytest.raises(InvalidSignatureError):
        verify_webhook(SECRET, header, body, now=now)


def test_the_clock_is_asked_when_no_time_is_given() -> None:
    with pytest.raises(InvalidSignatureError, match="300 s"):
        verify_webhook(SECRET, signed(BODY, t=1_600_000_000), BODY)
