"""Following a session: each fix once and in order, by events or by asking."""

from __future__ import annotations

import json
from typing import Any

import httpx
import pytest
from conftest import SESSION, FakeService, ok, problem
from isodyn_client import Client, ConnectionFailedError, RetryPolicy, UnauthorizedError
from isodyn_client.bridges import DeviceFeed, SessionFeed
from isodyn_client.follow import Follower, PlanFix, newest_number
from test_client_sse import Stream

N = 12
CLOSED = SESSION | {"status": "closed", "next_seq": 3}


def page(numbers: list[int], next_cursor: str | None = None) -> dict[str, Any]:
    n = len(numbers)
    fixes = {
        "t_ms": [1000.0 * i for i in numbers], "kind": ["filtered"] * n, "x": [float(i) for i in numbers],
        "y": [0.0] * n, "cov_xx": [1.0] * n, "cov_xy": [0.0] * n, "cov_yy": [1.0] * n, "heading_deg": [0.0] * n,
        "status": ["ok"] * n, "quality": [1.0] * n, "sure": [True] * n, "walk_on_m": [None] * n,
        "level_id": ["lev_1"] * n,
    }  # fmt: skip
    return {"number": numbers, "seq": [0] * n, "fixes": fixes, "next_cursor": next_cursor}


class Server:
    """A session of ``N`` fixes; ``events`` are the connections of its stream, None: the path is unknown."""

    def __init__(self, events: list[bytes | Exception] | None, *, closed: bool = True, limit: int = 5) -> None:
        self.events = events
        self.closed = closed
        self.limit = limit
        self.stored = N
        self.asked: list[str] = []

    def handle(self, request: httpx.Request) -> httpx.Response:
        path = request.url.path.removeprefix("/v1/sessions/ses_1")
        self.asked.append(path)
        if path == "/events":
            return self._events()
        if path == "/positions":
            after = int(request.url.params.get("cursor", -1))
            numbers = list(range(after + 1, min(after + 1 + self.limit, self.stored)))
            more = bool(numbers) and numbers[-1] + 1 < self.stored
            return ok(page(numbers, str(numbers[-1]) if more else None))
        if path.startswith("/segments/"):
            return ok({"session_id": "ses_1", "seq": 2, "state": "done"})
        return ok(CLOSED if self.closed else SESSION)

    def _events(self) -> httpx.Response:
        if self.events is None:
            return problem(404, "not-found")
        piece = self.events.pop(0)
        if isinstance(piece, Exception):
            raise piece
        headers = {"Content-Type": "text/event-stream"}
        return httpx.Response(200, stream=Stream([piece], httpx.ReadError("cut")), headers=headers)

    def client(self) -> Client:
        retry = RetryPolicy(retries=0)
        return Client("http://s.test", "k", transport=httpx.MockTransport(self.handle), retry=retry)


def event(name: str, value: object, number: int | None = None) -> bytes:
    head = f"id: {number}\n" if number is not None else ""
    return f"{head}event: {name}\ndata: {json.dumps(value)}\n\n".encode()


def followed(server: Server, after: int = -1) -> list[int]:
    follower = Follower(server.client(), "ses_1", after, sleep=lambda _: None)
    return [fix.number for batch in follower.batches() for fix in batch]


@pytest.mark.parametrize("after", [-1, 0, 6, N - 1])
def test_by_asking_where_there_are_no_events(after: int) -> None:
    server = Server(None)
    assert followed(server, after) == list(range(after + 1, N))
    assert server.asked[0] == "/events"
    assert server.asked.count("/events") == 1


def test_events_overlap_miss_some_and_break_off_and_still_each_fix_comes_once() -> None:
    session = event("session", CLOSED)
    server = Server(
        [
            event("fixes", page([0, 1, 2]), 2) + b": ping\n\n" + event("fixes", page([2, 3]), 3),
            httpx.ConnectError("away"),
            event("fixes", page([1, 2, 3]), 3) + event("fixes", page([7, 8]), 8),  # 4 to 6 never came
            b"",
            event("other", {"x": 1}) + event("fixes", page([9]), 9) + session,  # 10 and 11 after the end
        ]
    )
    assert followed(server) == list(range(N))


def test_an_open_session_is_asked_until_it_ends_and_gives_the_caller_a_turn() -> None:
    server = Server(None, closed=False)
    server.stored = 3
    follower = Follower(server.client(), "ses_1", sleep=lambda _: None)
    found, turns = [], 0
    for batch in follower.batches():
        found += [fix.number for fix in batch]
        if not batch:
            turns += 1
            server.stored, server.closed = (N, True) if turns == 3 else (3 + turns, False)
    assert found == list(range(N))
    assert turns == 3


def test_what_is_refused_is_an_error() -> None:
    client = Client("http://s.test", transport=httpx.MockTransport(lambda _: problem(401, "unauthorized")))
    with pytest.raises(UnauthorizedError):
        list(Follower(client, "ses_1").batches())


def test_trouble_is_told_and_following_goes_on() -> None:
    server = Server(None)
    failing = [httpx.ConnectError("away")] * 3
    told: list[str] = []

    def handle(request: httpx.Request) -> httpx.Response:
        if request.url.path.endswith("/positions") and failing:
            raise failing.pop()
        return server.handle(request)

    client = Client("http://s.test", "k", transport=httpx.MockTransport(handle), retry=RetryPolicy(retries=0))
    quiet = Follower(client, "ses_1", sleep=lambda _: None)
    with pytest.raises(ConnectionFailedError):
        list(quiet.batches())
    follower = Follower(client, "ses_1", on_trouble=lambda e: told.append(str(e)), sleep=lambda _: None)
    assert [fix.number for batch in follower.batches() for fix in batch] == list(range(N))
    assert len(told) == 2


def test_a_bridge_begins_with_the_newest_segment(service: FakeService, client: Client) -> None:
    info = client.session_info
    service.will(ok(SESSION | {"next_seq": 5}))
    session = info("ses_1")
    service.will(ok(page([])), problem(404, "not-found"), ok(page([7])))
    assert newest_number(client, session) == 6
    assert [r.url.params["seq"] for r in service.requests[1:]] == ["4", "3", "2"]
    service.will(ok(SESSION))
    assert newest_number(client, info("ses_1")) == -1


def test_rows_are_plain_values() -> None:
    server = Server(None)
    (first, *_) = next(Follower(server.client(), "ses_1").batches())
    assert isinstance(first, PlanFix)
    assert (type(first.x), type(first.sure), first.level_id) == (float, bool, "lev_1")


VENUE = {"id": "ven_1", "name": "Mall", "kind": "indoor", "created_at": SESSION["created_at"],
         "updated_at": SESSION["created_at"], "anchor": {"latitude_deg": 48.0, "longitude_deg": 11.0}}  # fmt: skip


def test_a_session_feed_knows_the_anchor() -> None:
    server = Server(None)

    def handle(request: httpx.Request) -> httpx.Response:
        return ok(VENUE) if request.url.path == "/v1/venues/ven_1" else server.handle(request)

    client = Client("http://s.test", "k", transport=httpx.MockTransport(handle))
    feed = SessionFeed(client, "ses_1", from_start=True, sleep=lambda _: None)
    told = [one for batch in feed.batches() for one in batch]
    assert [one.fix.number for one in told] == list(range(N))
    assert {(one.session.id, one.anchor.latitude_deg) for one in told if one.anchor} == {("ses_1", 48.0)}


def test_a_device_feed_goes_on_with_newer_sessions_only() -> None:
    """Sessions a (old, never closed), b, c; b ends, then c opens; a is never gone back to."""
    stamps = {"a": "2026-11-22T08:00:00Z", "b": "2026-11-22T09:00:00Z", "c": "2026-11-22T10:00:00Z"}
    open_now = ["b", "a"]

    def handle(request: httpx.Request) -> httpx.Response:
        parts = request.url.path.split("/")[2:]
        if parts == ["devices", "dev_1"]:
            created = SESSION["created_at"]
            return ok({"id": "dev_1", "name": "cart", "model": None, "created_at": created})
        if parts[0] == "venues":
            return ok(VENUE)
        if parts == ["sessions"]:
            return ok({"items": [SESSION | {"id": s, "created_at": stamps[s]} for s in open_now], "next_cursor": None})
        if parts[2:] == ["events"]:
            return problem(404, "not-found")
        if parts[2:] == ["positions"]:
            return ok(page([0] if "cursor" not in request.url.params else []))
        return ok(SESSION | {"id": parts[1], "status": "closed", "created_at": stamps[parts[1]]})

    client = Client("http://s.test", "k", transport=httpx.MockTransport(handle))
    turns = 0
    seen = []
    for batch in DeviceFeed(client, "dev_1", from_start=True, sleep=lambda _: None).batches():
        seen += [one.session.id for one in batch]
        if not batch:
            turns += 1
            open_now[:] = ["a"] if turns < 3 else ["c", "a"]
        if turns > 6:
            break
    assert seen == ["b", "c"]
