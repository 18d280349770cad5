"""From segments over HTTP to signed messages at a real server, whatever is killed on the way."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from isodyn_client import verify_webhook

from tests.e2e.conftest import MakeService, Prepared
from tests.e2e.service import Service
from tests.e2e.synthetic import trip
from tests.support.receiver import DROP, HANG, Receiver
from tests.workers.polling import eventually

pytestmark = [pytest.mark.e2e, pytest.mark.slow, pytest.mark.timeout(900)]

N_SESSIONS = 3
EDGE_X = 10.0
WEST_HALF = [[-2.0, -2.0], [EDGE_X, -2.0], [EDGE_X, 14.0], [-2.0, 14.0]]
ALLOWED = {"ISODYN_WEBHOOK_PRIVATE_NETWORKS": "true", "ISODYN_WEBHOOK_TIMEOUT_S": "2"}
KINDS = ("enter", "leave", "dwell")
Told = list[tuple[str, str, float]]


@pytest.fixture
def receiver() -> Iterator[Receiver]:
    with Receiver() as made:
        yield made


def watch(service: Service, prepared: Prepared, receiver: Receiver) -> tuple[str, str]:
    """Draw the west half of the hall; returns the geofence's id and the webhook's secret."""
    body = {"name": "west", "level_id": prepared.level_id, "polygon": WEST_HALF, "events": KINDS, "dwell_s": 4.0}
    geofence = service.post("/v1/geofences", body)
    wanted = {"url": receiver.url, "events": [f"geofence.{kind}" for kind in KINDS], "level_id": prepared.level_id}
    return geofence["id"], service.post("/v1/webhooks", wanted)["secret"]


def some(prepared: Prepared) -> dict[str, list[dict[str, Any]]]:
    return dict(list(prepared.bodies.items())[:N_SESSIONS])


def send(service: Service, prepared: Prepared, first: int = 0, last: int | None = None) -> None:
    for session_id, bodies in some(prepared).items():
        for body in bodies[first:last]:
            answer = service.request("POST", f"/v1/sessions/{session_id}/segments", json=body)
            assert answer.status_code in (200, 202), answer.text


def close(service: Service, prepared: Prepared) -> None:
    for session_id in some(prepared):
        service.request("POST", f"/v1/sessions/{session_id}/close")


def events(service: Service) -> list[dict[str, Any]]:
    """Oldest first."""
    items: list[dict[str, Any]] = service.get("/v1/geofence-events", limit=500)["items"]
    return items[::-1]


def told(items: list[dict[str, Any]]) -> Told:
    return sorted((item["session_id"], item["kind"], item["t_ms"]) for item in items)


def all_settled(service: Service) -> bool:
    (webhook,) = service.get("/v1/webhooks")["items"]
    return not service.get(f"/v1/webhooks/{webhook['id']}/deliveries", state="pending")["items"]


def distinct(receiver: Receiver) -> list[str]:
    """Ids of events in the order in which each came first."""
    return list(dict.fromkeys(got.headers["Isodyn-Event-Id"] for got in receiver.got))


def test_walks_through_a_geofence_are_told_as_they_were(
    make_service: MakeService, prepared: Prepared, receiver: Receiver
) -> None:
    service = make_service(**ALLOWED)
    service.start()
    geofence_id, secret = watch(service, prepared, receiver)
    send(service, prepared)
    close(service, prepared)
    service.await_all_jobs()
    stored = events(service)
    eventually(lambda: len(receiver.got) >= len(stored))
    assert [item["geofence_id"] for item in stored] == [geofence_id] * len(stored)
    messages = [verify_webhook(secret, got.headers["Isodyn-Signature"], got.body) for got in receiver.got]
    assert [message.data for message in messages] == stored
    assert {message.type for message in messages} == {f"geofence.{kind}" for kind in KINDS}
    for number, session_id in enumerate(some(prepared)):
        walk = trip(number, t0=1.75e9)
        mine = [item for item in stored if item["session_id"] == session_id]
        crossings = [item for item in mine if item["kind"] != "dwell"]
        # laps cross the edge twice each; the walker starts in the west
        assert [item["kind"] for item in crossings] == ["enter", "leave"] * (len(crossings) // 2)
        assert len(crossings) >= 4
        for item in crossings:
            if item["reason"] is None and item is not crossings[0]:
                x = float(np.interp(item["t_ms"] / 1000.0, walk.samples.t, walk.x))
                assert abs(x - EDGE_X) < 4.0, f"{item['kind']} told {x - EDGE_X:+.1f} m from the edge"
    assert service.metric("isodyn_webhook_errors_total") == 0
    assert secret not in service.log


def test_killing_the_service_loses_and_doubles_no_event(
    make_service: MakeService, prepared: Prepared, receiver: Receiver
) -> None:
    """Killed twice: while segments are processed, and while a message is on its way to a server that fails."""
    quiet = make_service(**ALLOWED)
    quiet.start()
    with Receiver() as ignored:
        watch(quiet, prepared, ignored)
        send(quiet, prepared)
        close(quiet, prepared)
        quiet.await_all_jobs()
        expected = told(events(quiet))
        quiet.terminate()
    assert len(expected) > 4 * N_SESSIONS

    service = make_service(ISODYN_WORKERS="1", **ALLOWED)
    service.start()
    _, secret = watch(service, prepared, receiver)
    receiver.plan = [500, HANG, DROP, 503, 204, HANG]
    n_hanging = 2
    send(service, prepared, last=2)
    eventually(lambda: len(receiver.got) >= n_hanging)
    service.kill()

    service.start()
    send(service, prepared)  # the first ones again, as a client would that never saw the answers
    close(service, prepared)
    states = [job["state"] for job in service.jobs()]
    assert states.count("queued") + states.count("running") >= 1, "nothing was left to interrupt"
    service.kill()

    service.start()
    service.await_all_jobs()
    stored = events(service)
    assert told(stored) == expected
    eventually(lambda: all_settled(service), 60.0)
    assert distinct(receiver) == [item["id"] for item in stored], "each at least once, in order"
    assert len(receiver.got) > len(stored), "no message had to be sent again: nothing was interrupted"
    for got in receiver.got:
        verify_webhook(secret, got.headers["Isodyn-Signature"], got.body, tolerance_s=900.0)
