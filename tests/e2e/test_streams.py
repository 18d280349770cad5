"""Sessions over WebSockets and event streams, cut at will: every fix once, in order."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterator
from typing import Any

import httpx
import pytest
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect

from tests.e2e.conftest import MakeService, Prepared
from tests.e2e.service import Service, open_session, segment_bodies
from tests.e2e.synthetic import Walk, trip

pytestmark = [pytest.mark.e2e, pytest.mark.timeout(300)]
SEGMENT_S = 5.0


@pytest.fixture
def service(make_service: MakeService) -> Service:
    made = make_service()
    made.start()
    return made


@pytest.fixture(scope="module")
def walk() -> Walk:
    return trip(41, t0=1.76e9)


@contextlib.contextmanager
def stream(service: Service, session_id: str, after: int = -1) -> Iterator[ClientConnection]:
    url = f"ws://127.0.0.1:{service.port}/v1/sessions/{session_id}/stream?after={after}"
    with connect(url, additional_headers={"Authorization": f"Bearer {service.key}"}) as connection:
        yield connection


def receive(connection: ClientConnection) -> dict[str, Any]:
    message: dict[str, Any] = json.loads(connection.recv(timeout=30.0))
    return message


def events(service: Service, path: str, **headers: str) -> Iterator[tuple[str, str | None, Any]]:
    """Name, id and data of each event until the stream ends."""
    assert service.http is not None
    with service.http.stream("GET", path, headers=headers, timeout=60.0) as answer:
        assert answer.status_code == 200, answer.read()
        fields: dict[str, str] = {}
        for line in answer.iter_lines():
            name, _, value = line.partition(": ")
            if line and name:
                fields[name] = value
            elif fields:
                yield fields["event"], fields.get("id"), json.loads(fields["data"])
                fields = {}


def stored(service: Service, session_id: str) -> list[list[Any]]:
    page = service.get(f"/v1/sessions/{session_id}/positions", limit=500)
    assert page["next_cursor"] is None
    return numbered(page)


def numbered(page: dict[str, Any]) -> list[list[Any]]:
    fixes = page["fixes"]
    return [list(row) for row in zip(page["number"], fixes["t_ms"], fixes["x"], fixes["y"], strict=True)]


def test_a_stream_that_is_cut_again_and_again_tells_each_fix_once(
    service: Service, prepared: Prepared, walk: Walk
) -> None:
    session_id = open_session(service, prepared.level_id, walk)
    bodies = segment_bodies(walk, SEGMENT_S)
    assert len(bodies) >= 5
    told: list[list[Any]] = []
    over = False
    for _ in range(20):
        after = told[-1][0] if told else -1
        with stream(service, session_id, after) as connection:
            ready = receive(connection)
            assert (ready["type"], ready["after"]) == ("ready", after)
            # one segment more than is waited for, then the line goes dead
            for body in bodies[ready["next_seq"] : ready["next_seq"] + 2]:
                connection.send(json.dumps(body))
            if ready["next_seq"] == len(bodies):
                connection.send(json.dumps({"type": "close"}))
            while not over:
                message = receive(connection)
                if message["type"] == "fixes":
                    told += numbered(message)
                    if ready["next_seq"] < len(bodies):
                        break
                over = message["type"] == "session"
                assert message["type"] != "problem", message
        if over:
            break
    assert over
    assert told == stored(service, session_id)
    assert [row[0] for row in told] == list(range(len(told)))


def test_a_watcher_that_comes_back_reads_on_where_it_was(service: Service, prepared: Prepared, walk: Walk) -> None:
    session_id = open_session(service, prepared.level_id, walk)
    bodies = segment_bodies(walk, SEGMENT_S)
    path = f"/v1/sessions/{session_id}/events"
    told: list[list[Any]] = []
    seen: str | None = None
    for body in bodies:
        service.post(f"/v1/sessions/{session_id}/segments", body)
        for name, number, data in events(service, path, **({} if seen is None else {"Last-Event-ID": seen})):
            assert name == "fixes"
            told += numbered(data)
            seen = number
            break
    service.post(f"/v1/sessions/{session_id}/close", {})
    *rest, last = events(service, path, **{"Last-Event-ID": seen or "-1"})
    for name, _, data in rest:
        assert name == "fixes"
        told += numbered(data)
    assert (last[0], last[2]["status"]) == ("session", "closed")
    assert told == stored(service, session_id)


def test_a_bad_segment_is_answered_and_the_stream_goes_on(service: Service, prepared: Prepared, walk: Walk) -> None:
    session_id = open_session(service, prepared.level_id, walk)
    first, second, *_ = segment_bodies(walk, SEGMENT_S)
    with stream(service, session_id) as connection:
        assert receive(connection)["type"] == "ready"
        connection.send(json.dumps(second))
        gap = receive(connection)
        assert (gap["type"], gap["problem"]["status"]) == ("problem", 409)
        assert gap["problem"]["errors"][0]["field"] == "seq"
        connection.send(b"\x00 no msgpack")
        assert receive(connection)["problem"]["status"] == 400
        connection.send(json.dumps({"type": "dance"}))
        assert receive(connection)["problem"]["errors"][0]["field"] == "type"
        connection.send("[" * 300)
        assert receive(connection)["problem"]["status"] == 422
        connection.send(json.dumps(first))
        assert receive(connection) == {"type": "accepted", "seq": 0, "repeated": False}
        connection.send(json.dumps(first))
        answers = [receive(connection) for _ in range(2)]
        assert {"type": "accepted", "seq": 0, "repeated": True} in answers


def test_a_key_comes_in_a_header_or_in_the_first_message(service: Service, prepared: Prepared, walk: Walk) -> None:
    session_id = open_session(service, prepared.level_id, walk)
    url = f"ws://127.0.0.1:{service.port}/v1/sessions/{session_id}/stream"
    with connect(url) as connection:
        connection.send(json.dumps({"type": "auth", "key": service.key}))
        assert receive(connection)["type"] == "ready"
    for key, session in (("isk_wrong", session_id), (service.key, "ses_none")):
        with connect(url.replace(session_id, session)) as connection:
            connection.send(json.dumps({"type": "auth", "key": key}))
            problem = receive(connection)["problem"]
            with pytest.raises(ConnectionClosed) as closed:
                connection.recv(timeout=10)
            assert closed.value.rcvd is not None
            assert closed.value.rcvd.code == 4000 + problem["status"]
            assert key not in json.dumps(problem)


def test_a_first_message_that_is_no_key_is_refused_in_words(service: Service, prepared: Prepared, walk: Walk) -> None:
    session_id = open_session(service, prepared.level_id, walk)
    url = f"ws://127.0.0.1:{service.port}/v1/sessions/{session_id}/stream"
    for first in (b"\x81\xa3key\xa1x", "[]"):
        with connect(url) as connection:
            connection.send(first)
            assert receive(connection)["problem"]["status"] == 401


def test_streams_end_with_their_key(service: Service, prepared: Prepared, walk: Walk) -> None:
    session_id = open_session(service, prepared.level_id, walk)
    made = service.post("/v1/keys", {"name": "short-lived", "scopes": ["locate"]})
    key = {"Authorization": f"Bearer {made['secret']}"}
    url = f"ws://127.0.0.1:{service.port}/v1/sessions/{session_id}/stream"
    following = events(service, "/v1/live", **key)
    with connect(url, additional_headers=key) as connection:
        assert receive(connection)["type"] == "ready"
        assert next(following)[0] == "snapshot"
        assert service.request("DELETE", f"/v1/keys/{made['id']}").status_code == 204
        connection.send(json.dumps({"type": "close"}))
        assert receive(connection)["problem"]["status"] == 401
        with pytest.raises(ConnectionClosed) as closed:
            connection.recv(timeout=10)
        assert closed.value.rcvd is not None
        assert closed.value.rcvd.code == 4401
    open_session(service, prepared.level_id, walk)
    assert list(following) == []
    assert service.get(f"/v1/sessions/{session_id}")["status"] == "open"


@pytest.mark.parametrize("number", ["--1", "-", "-2", "1.5", "x"])
def test_a_last_event_id_that_is_no_number_is_refused(
    service: Service, prepared: Prepared, walk: Walk, number: str
) -> None:
    session_id = open_session(service, prepared.level_id, walk)
    answer = service.request("GET", f"/v1/sessions/{session_id}/events", headers={"Last-Event-ID": number})
    assert answer.status_code == 422


def test_all_sessions_are_followed_at_once(service: Service, prepared: Prepared, walk: Walk) -> None:
    before = open_session(service, prepared.level_id, walk)
    told = events(service, f"/v1/live?level_id={prepared.level_id}")
    name, _, snapshot = next(told)
    assert name == "snapshot"
    assert before in {one["session_id"] for one in snapshot["sessions"]}
    body = segment_bodies(walk, SEGMENT_S)[0]
    session_id = open_session(service, prepared.level_id, walk)
    done = service.post(f"/v1/sessions/{session_id}/segments", body, Prefer="wait=30")
    service.post(f"/v1/sessions/{session_id}/close", {})
    found: dict[str, list[Any]] = {}
    for name, _, data in told:
        found.setdefault(name, []).append(data)
        if data.get("status") == "closed":
            break
    assert [one["status"] for one in found["session"]] == ["open", "closed"]
    (fix,) = found["fix"]
    assert {one["session_id"] for one in found["fix"]} == {session_id}
    assert (fix["x"], fix["y"], fix["t_ms"]) == tuple(done["position"][name] for name in ("x", "y", "t_ms"))


def test_open_streams_do_not_hold_up_a_stop(service: Service, prepared: Prepared, walk: Walk) -> None:
    session_id = open_session(service, prepared.level_id, walk)
    told = events(service, "/v1/live")
    assert next(told)[0] == "snapshot"
    with stream(service, session_id) as connection:
        assert receive(connection)["type"] == "ready"
        assert service.process is not None
        service.process.terminate()
        with pytest.raises(ConnectionClosed) as closed:
            connection.recv(timeout=10)
        assert closed.value.rcvd is not None
        assert closed.value.rcvd.code == 1012
        with contextlib.suppress(httpx.RemoteProtocolError):
            assert list(told) == []
    assert service.process.wait(8.0) == 0
