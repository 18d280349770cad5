"""Events: the format of the HTML standard, however the stream is cut, and connections made again."""

from __future__ import annotations

import random
from collections.abc import Iterator
from itertools import islice, pairwise

import httpx
import pytest
from conftest import FakeService, problem
from hypothesis import given
from hypothesis import strategies as st
from isodyn_client import ConnectionFailedError, NotFoundError, UnexpectedAnswerError
from isodyn_client.sse import Event, EventParser, Ping, events, lines_of

STREAM = (
    b'\xef\xbb\xbf: hello\n\nevent: fixes\nid: 7\ndata: {"a":\ndata: 1}\n\n'
    b"data:no space\nid\n\nretry: 1500\nevent: empty\n\nevent: session\r\n"
    b"data:  \xc3\xa4\xe2\x80\xa8\r\n\r\ndata: cut off"
)
EVENTS = [
    Ping(),
    Event("fixes", '{"a":\n1}', "7"),
    Event("message", "no space", ""),
    Event("session", " ä\u2028", ""),
]


class Stream(httpx.SyncByteStream):
    """Pieces of a body, then the error that ends it, if there is one."""

    def __init__(self, pieces: list[bytes], error: Exception | None = None) -> None:
        self.pieces, self.error = pieces, error

    def __iter__(self) -> Iterator[bytes]:
        yield from self.pieces
        if self.error is not None:
            raise self.error


def streaming(*pieces: bytes, error: Exception | None = None) -> httpx.Response:
    return httpx.Response(200, stream=Stream(list(pieces), error), headers={"Content-Type": "text/event-stream"})


def test_the_format() -> None:
    parser = EventParser()
    assert list(parser.feed(lines_of([STREAM]))) == EVENTS
    assert parser.retry_s == 1.5


@given(st.lists(st.integers(0, len(STREAM))), st.sampled_from([b"\n", b"\r\n", b"\r"]))
def test_the_same_events_however_the_stream_is_cut(cuts: list[int], end: bytes) -> None:
    stream = STREAM.replace(b"\r\n", b"\n").replace(b"\n", end)
    bounds = [0, *sorted(min(cut, len(stream)) for cut in cuts), len(stream)]
    pieces = [stream[a:b] for a, b in pairwise(bounds)]
    assert list(EventParser().feed(lines_of(pieces))) == EVENTS


def test_a_cut_connection_goes_on_behind_the_last_event(service: FakeService) -> None:
    service.will(
        streaming(b"id: 3\ndata: a\n\nid: 9\ndata: unfin", error=httpx.ReadError("gone")),
        httpx.ConnectError("away"),
        httpx.Response(503, headers={"Retry-After": "7"}),
        streaming(b"id: 4\ndata: b\n\n"),
    )
    client = service.client()
    stream = events(client, "/v1/e", params={"after": 2}, sleep=service.pauses.append, rng=random.Random(1))
    assert [e.data for e in islice(stream, 2) if isinstance(e, Event)] == ["a", "b"]
    first, *later = service.requests
    assert first.url.params["after"] == "2"
    assert first.headers["Accept"] == "text/event-stream"
    assert first.headers["Authorization"] == "Bearer isk_test"
    # not 9: that event was cut off
    assert [request.headers["Last-Event-ID"] for request in later] == ["3"] * 3
    assert all("after" not in request.url.params for request in later)
    assert service.pauses[2] == 7.0


def test_refusals_and_other_pages_are_errors(service: FakeService) -> None:
    client = service.client()
    service.will(problem(404, "not-found"))
    with pytest.raises(NotFoundError):
        next(events(client, "/v1/e"))
    service.will(httpx.Response(200, text="<html>"))
    with pytest.raises(UnexpectedAnswerError):
        next(events(client, "/v1/e"))


def test_it_gives_up_after_attempts_without_an_event(service: FakeService) -> None:
    service.will(*[httpx.ConnectError("away")] * 9)
    with pytest.raises(ConnectionFailedError, match="away"):
        next(events(service.client(), "/v1/e", sleep=service.pauses.append))
    assert len(service.pauses) == 8
    service.will(*[streaming() for _ in range(9)])
    with pytest.raises(ConnectionFailedError, match="without an event"):
        next(events(service.client(), "/v1/e", sleep=service.pauses.append))
